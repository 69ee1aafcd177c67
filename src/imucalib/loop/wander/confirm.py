"""What stays of a search once it was repeated without each block of time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.loop.difference import Difference
from imucalib.loop.found import Step
from imucalib.loop.wander.choice import Refused, Search, Taken
from imucalib.loop.wander.forms import FAMILY, driver_of
from imucalib.loop.wander.likelihood import Terms, best_level
from imucalib.loop.wander.report import Predicted

#: Share of the searches without a block that must find an effect again, and one that time drives.
_AGAIN, _AGAIN_IN_TIME = 0.5, 0.8
#: Evidence over the bar that stands without a proved gain on the blocks, but for what is driven by
#: time: under a walk of half a day steps of 17 nats over a bar of 9 were seen where nothing was.
_CLEAR = 1.5


def confirmed(
    search: Search,
    steps: Sequence[Step],
    bars: Sequence[Array],
    base: Terms,
    each: Predicted,
    gained: Callable[[Taken], Difference],
) -> Search:
    """The search without the effects that there is a reason to doubt.

    steps : of the search, with their aliases; bars : of its rounds, (2,) each
    gained : on the blocks that may tell of an effect
    """
    doubted = list[Refused]()
    for taken, step, bar in zip(search.taken, steps, bars, strict=False):
        if why := _doubt(taken, step, float(bar[0]), each, gained(taken)):
            doubted.append(Refused(step.effect, taken.found, why))
    return without(search, doubted, base)


def without(search: Search, refused: Sequence[Refused], base: Terms) -> Search:
    """The search without some of what it took."""
    if not refused:
        return search
    gone = {one.found.entry.name for one in refused}
    kept = tuple(t for t in search.taken if t.found.entry.name not in gone)
    terms = base
    for taken in kept:
        terms = terms.plus(taken.found.entry.columns, taken.size)
    keep = np.ones(search.bank.course.parts, dtype=bool)
    level = best_level(search.bank, terms, keep)
    told = (*search.refused, *refused)
    return replace(search, terms=terms, level=level, taken=kept, refused=told)


def _doubt(taken: Taken, step: Step, bar: float, each: Predicted, gained: Difference) -> str:
    own = {name.partition("@")[0] for name in (step.effect, *step.aliases)}
    if taken.found.entry.family == FAMILY:  # a name of its driver is the same, less bent
        own.add(driver_of(taken.found.entry))
    again = sum(bool(own & one) for one in each.found)
    need = _AGAIN_IN_TIME if taken.found.entry.timed else _AGAIN
    if again < need * len(each.found):
        return f"found again in {again} of {len(each.found)} searches without a block of time"
    clear = not taken.found.entry.timed and taken.found.evidence >= _CLEAR * bar
    if gained.likely or clear:
        return ""
    return (
        f"the search without each block of time gains {gained.nats:+.1f} nats there, "
        f"at least {gained.nats_low:+.1f}"
    )
