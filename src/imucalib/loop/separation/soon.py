"""How few of a plan's observations are enough most of the time.

A plan has to end the ambiguity whichever rival is the truth, so that most of it is for the rival
that the recording already speaks against: what that one would need is the lead of the other and the
margin as well. With each rival as likely as the recording makes it, fewer do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.loop.separation.choice import Pool, Worth, total_of
from imucalib.loop.separation.products import Ambiguity
from imucalib.loop.separation.prospect import Added, ends, weights


@dataclass(frozen=True)
class Soon:
    """The first observations of a plan. count : so many; chance : that they end the ambiguity, each
    rival as likely as the recording makes it; ended : were it each; likely : how likely each is"""

    count: int
    chance: float
    ended: Mapping[str, float]
    likely: Mapping[str, float]


def in_order(pool: Pool, plan: tuple[int, ...], worth: Worth) -> tuple[int, ...]:
    """The same observations, each the one that helps most beside those before it."""
    left, ordered = list(plan), list[int]()
    while left:
        each = worth(total_of(pool, tuple(ordered)) + pool.gram[left])
        ordered.append(left.pop(int(np.argmax(each))))
    return tuple(ordered)


def soon(
    ambiguity: Ambiguity,
    pool: Pool,
    plan: tuple[int, ...],
    against: Mapping[str, Sequence[str]],
    rng: np.random.Generator,
    *,
    fewest: int,
    enough: float,
    draws: int,
) -> Soon | None:
    """The fewest of a plan's first observations that are `enough`; None where all are needed.

    against : truth -> the rivals that it has to stand apart from
    """
    if not plan or not against:
        return None
    every = weights(ambiguity)
    total = sum(every[name] for name in against)
    likely = {name: every[name] / total for name in against}
    for count in range(fewest, len(plan)):
        added = Added(total_of(pool, plan[:count]), pool.numbers * count)
        ended = ends(ambiguity, added, rng, draws, against)
        chance = sum(likely[name] * ended[name] for name in against)
        if chance >= enough:
            return Soon(count, chance, ended, likely)
    return None
