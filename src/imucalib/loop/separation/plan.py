"""The plan that ends an ambiguity soonest, what it promises, and what other plans would need."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.loop.separation.angle import Pair, apart, pairs_of
from imucalib.loop.separation.choice import (
    Pool,
    exchanged,
    grown,
    informative,
    one_by_one,
    separating,
    total_of,
)
from imucalib.loop.separation.products import Ambiguity
from imucalib.loop.separation.prospect import Added, ends
from imucalib.loop.separation.soon import Soon, in_order, soon

#: Share of simulated outcomes, of every rival as the truth, that a plan has to end.
ENOUGH = 0.9
#: Fewer observations would hang on one: an effect that one reading shows is a wrong record's too.
FEWEST = 4
#: Observations that a plan has at most, draws behind what it promises, and random plans.
MOST, _DRAWS, _RANDOM = 24, 1000, 24
#: Sine of the angle below which no number of observations tells a pair apart, and how much of
#: everything that could be recorded stands for any number of them.
_SAME, _ANY_NUMBER = 3e-3, 1e6
#: Times as many observations as the plan's up to which other plans are followed.
_LONGER = 8


@dataclass(frozen=True)
class Beside:
    """Another plan. apart : expected λ sin(angle) of as many observations; needed : how many of its
    observations reach that of the plan, None where `followed` do not; most : that were followed"""

    apart: float
    needed: int | None
    followed: int


@dataclass(frozen=True)
class Separation:
    """effect, rivals, nats : of the ambiguity; plan : candidates in the order of choosing
    pairs : (truth, other) that can be told apart; now, apart : their expected λ sin(angle) without
    and with the plan; ended : rival -> share of outcomes in which it is named alone, were it
    the truth (of those that can be told from it); never : pairs (truth, other) that nothing which
    can be recorded tells apart; informative, random : other plans
    soon : the first of the plan that are enough most of the time, where that is less than all"""

    effect: str
    rivals: tuple[str, ...]
    nats: Mapping[str, float]
    pairs: tuple[tuple[str, str], ...]
    plan: tuple[int, ...]
    now: Array
    apart: Array
    ended: Mapping[str, float]
    never: tuple[tuple[str, str], ...]
    informative: Beside | None = None
    random: Beside | None = None
    soon: Soon | None = None

    @property
    def least(self) -> float:
        """Expected λ sin(angle) of the pair that is told apart worst."""
        return float(self.apart.min(initial=np.inf))

    @property
    def enough(self) -> bool:
        """Whether the plan ends the ambiguity, whichever rival is the truth."""
        ended = min(self.ended.values(), default=0.0) >= ENOUGH
        return bool(self.plan) and ended and not self.never


def separation(
    ambiguity: Ambiguity,
    pool: Pool,
    rng: np.random.Generator,
    most: int = MOST,
    fewest: int = FEWEST,
) -> Separation:
    """The fewest candidates of a pool, each as often as it pays, that end an ambiguity."""
    old = ambiguity.products.gram
    every = pairs_of(ambiguity)
    pairs = tuple(p for p in every if can_be_told(ambiguity, pool, p))
    never = tuple((p.truth, p.other) for p in every if p not in pairs)
    against = {t: tuple(p.other for p in pairs if p.truth == t) for t in ambiguity.rivals}
    against = {truth: others for truth, others in against.items() if others}
    plan: tuple[int, ...] = ()
    ended: Mapping[str, float] = {}
    worth = separating(old, pairs) if pairs else None
    while worth is not None and len(plan) < most:
        plan = grown(pool, plan, worth)
        if len(plan) < min(fewest, most):
            continue
        added = Added(total_of(pool, plan), pool.numbers * len(plan))
        ended = ends(ambiguity, added, rng, _DRAWS, against)
        if min(ended.values()) >= ENOUGH:
            break
    if worth is not None:
        plan = in_order(pool, plan, worth)
    reached = apart(old + total_of(pool, plan), pairs) if pairs else np.zeros(0)
    others = _others(ambiguity, pool, pairs, plan, rng) if plan else (None, None)
    early = soon(ambiguity, pool, plan, against, rng, fewest=fewest, enough=ENOUGH, draws=_DRAWS)
    return Separation(
        effect=ambiguity.effect,
        rivals=ambiguity.rivals,
        nats=ambiguity.nats,
        pairs=tuple((p.truth, p.other) for p in pairs),
        plan=plan,
        now=apart(old, pairs) if pairs else np.zeros(0),
        apart=reached,
        ended=ended,
        never=never,
        informative=others[0],
        random=others[1],
        soon=early,
    )


def can_be_told(ambiguity: Ambiguity, pool: Pool, pair: Pair) -> bool:
    """Whether any number of candidates would tell the truth of a pair from the other."""
    gram = ambiguity.products.gram + _ANY_NUMBER * pool.gram.mean(axis=0)
    left = float(apart(gram, (pair,))[0])
    alone = replace(pair, other="", rest=pair.rest[:0])
    return left > _SAME * float(apart(gram, (alone,))[0])


def _others(
    ambiguity: Ambiguity,
    pool: Pool,
    pairs: tuple[Pair, ...],
    plan: tuple[int, ...],
    rng: np.random.Generator,
) -> tuple[Beside, Beside]:
    old, count = ambiguity.products.gram, len(plan)
    longest = _LONGER * count
    goal = float(apart(old + total_of(pool, plan), pairs).min())

    def least(gram: Array) -> Array:
        return np.asarray(apart(old + gram, pairs).min(axis=-1))

    best = informative(old, ambiguity.first)
    steps = one_by_one(pool, best, longest)
    sums = np.cumsum(pool.gram[list(steps)], axis=0)
    reached = least(sums)
    reached[count - 1] = least(total_of(pool, exchanged(pool, steps[:count], best))[None])[0]
    random = rng.integers(0, len(pool.gram), (_RANDOM, longest))
    told = np.stack([least(np.cumsum(pool.gram[one], axis=0)) for one in random])
    return beside(reached, count, goal), beside(np.median(told, axis=0), count, goal)


def beside(reached: Array, count: int, goal: float) -> Beside:
    enough = np.flatnonzero(reached >= goal)
    needed = int(enough[0]) + 1 if enough.size else None
    return Beside(float(reached[count - 1]), needed, len(reached))
