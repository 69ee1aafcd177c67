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
    seed = int(rng.integers(2**63))

    def after(k: int) -> tuple[int, Mapping[str, float]]:
        """The best candidate k times, and how often each rival has ended: by the same draws, so
        that more of it does not seem to tell less."""
        best = int(np.argmax(worth(k * menu.gram)))
        added = Added(k * menu.gram[best], k * menu.numbers)
        return best, ends(ambiguity, added, np.random.default_rng(seed), _DRAWS, against)

    count, best, ended = _fewest(after)

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


def _fewest(
    after: Callable[[int], tuple[int, Mapping[str, float]]],
) -> tuple[int, int, Mapping[str, float]]:
    """The fewest times that end it, or the most that are tried; with what these have."""
    known: dict[int, tuple[int, Mapping[str, float]]] = {}

    def over(k: int) -> bool:
        known[k] = after(k)
        return min(known[k][1].values()) >= ENOUGH

    least, most = 1, 1
    while not over(most) and most < MOST:
        least, most = most + 1, min(2 * most, MOST)
    # Between a number that was too few and one that is enough, the others by halving.
    count = least + bisect_left(range(least, most), True, key=over)
    return (count, *known[count])


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
