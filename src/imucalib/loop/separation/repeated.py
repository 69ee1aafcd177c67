"""The one candidate of a menu, and how often of it, that ends an ambiguity: a motion, how long."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Mapping

import numpy as np

from imucalib.arrays import Array
from imucalib.loop.separation.angle import apart, pairs_of
from imucalib.loop.separation.choice import Pool, informative, separating
from imucalib.loop.separation.plan import ENOUGH, Beside, Separation, can_be_told
from imucalib.loop.separation.products import Ambiguity
from imucalib.loop.separation.prospect import Added, ends

#: How often a candidate is repeated at most, draws, and times as often for other choices.
MOST, _DRAWS, _LONGER = 24, 400, 8


def repeated(ambiguity: Ambiguity, menu: Pool, rng: np.random.Generator) -> Separation:
    """The candidate that separates best, as often as it takes; `plan` holds it as often.

    Beside it the candidate that tells most of the base model, and the median one.
    """
    old = ambiguity.products.gram
    every = pairs_of(ambiguity)
    pairs = tuple(p for p in every if can_be_told(ambiguity, menu, p))
    never = tuple((p.truth, p.other) for p in every if p not in pairs)
    against = {t: tuple(p.other for p in pairs if p.truth == t) for t in ambiguity.rivals}
    against = {truth: others for truth, others in against.items() if others}
    if not pairs:
        return _told(ambiguity, never=never)
    worth = separating(old, pairs)
    best, count, ended = 0, 0, dict[str, float]()
    while count < MOST:
        count += 1
        best = int(np.argmax(worth(count * menu.gram)))
        added = Added(count * menu.gram[best], count * menu.numbers)
        ended = dict(ends(ambiguity, added, rng, _DRAWS, against))
        if min(ended.values()) >= ENOUGH:
            break

    def reached(k: int, some: Array) -> float:
        """The median over some candidates (n, P, P), each k times."""
        return float(np.median([apart(old + k * gram, pairs).min() for gram in some]))

    goal = reached(count, menu.gram[best : best + 1])
    most = int(np.argmax(informative(old, ambiguity.first)(count * menu.gram)))
    return _told(
        ambiguity,
        never=never,
        pairs=tuple((p.truth, p.other) for p in pairs),
        plan=(best,) * count,
        now=apart(old, pairs),
        apart=apart(old + count * menu.gram[best], pairs),
        ended=ended,
        informative=_beside(lambda k: reached(k, menu.gram[most : most + 1]), count, goal),
        random=_beside(lambda k: reached(k, menu.gram), count, goal),
    )


def _beside(reached: Callable[[int], float], count: int, goal: float) -> Beside:
    """How far `count` times of another choice reach, and how many reach the goal. More of the same
    never tells less, so that a few are looked at, not all."""
    longest = _LONGER * count
    fewer = bisect_left(range(1, longest + 1), goal, key=reached)
    return Beside(reached(count), fewer + 1 if fewer < longest else None, longest)


def _told(ambiguity: Ambiguity, **found: object) -> Separation:
    nothing: Mapping[str, object] = {
        "pairs": (),
        "plan": (),
        "now": np.zeros(0),
        "apart": np.zeros(0),
        "ended": {},
    }
    whole = {**nothing, **found}
    return Separation(
        effect=ambiguity.effect,
        rivals=ambiguity.rivals,
        nats=ambiguity.nats,
        **whole,  # type: ignore[arg-type]
    )
