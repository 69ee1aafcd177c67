"""Whether a bias that wanders slowly does as well as what time drives, over one recording.

The noise of the search forgets within a sixth of the recording; a drift, a step, a warm-up and a
daily swing last longer, and so does a slow walk, which is none of them. Here the walk goes on
through the whole recording:

    lead = max over the search's walks of L(with the effect) - max over slower ones of L(without)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.loop.found import Step
from imucalib.loop.noise.shared import WANDERING
from imucalib.loop.thresholds import MARGIN
from imucalib.loop.wander.bank import Bank, bank_of
from imucalib.loop.wander.choice import Taken
from imucalib.loop.wander.likelihood import Terms, levels
from imucalib.loop.wander.walk import Course, Walk

#: Memories of a slow walk in recordings, and its variances over a run's, as fine as the search's.
_TAU, _RHO = (0.5, 2.0), (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0)


def beside_slow_walks(
    bank: Bank, base: Terms, every: Sequence[Taken], steps: Sequence[Step]
) -> tuple[Step, ...]:
    """The steps; with those that do not lead a slow walk by three nats, `wandering_bias`."""
    out = list[Step]()
    for taken, step in zip(every, steps, strict=True):
        if taken.found.entry.timed:
            others = base
            for other in every:
                if other is not taken:
                    others = others.plus(other.found.entry.columns, other.size)
            if lead(bank, others, taken) < MARGIN:
                step = replace(step, aliases=(*step.aliases, WANDERING))  # noqa: PLW2901
        out.append(step)
    return tuple(out)


def lead(bank: Bank, others: Terms, taken: Taken) -> float:
    """Nats by which an effect beside other terms leads the likeliest slow walk without it."""
    span = float(np.ptp(bank.course.time))
    slow = [Walk(rho, share * span) for share in _TAU for rho in _RHO]
    walks = (*bank.walks, *slow)
    columns = np.concatenate([others.columns, taken.found.entry.columns])
    one = _through(bank, walks, np.append(columns, bank.data))
    keep = np.ones(1, dtype=bool)
    at = np.arange(columns.size)
    without = Terms(at[: others.columns.size], others.precision, others.base)
    within = without.plus(at[others.columns.size :], taken.size)
    known = levels(one, within, keep)[: len(bank.walks)]
    slower = levels(one, without, keep)
    return max(level.nats for level in known) - max(level.nats for level in slower)


def _through(bank: Bank, walks: tuple[Walk, ...], columns: Array) -> Bank:
    """Some of the columns under walks that never begin anew."""
    course = bank.course
    whole = Course(course.time, course.seen, course.variance, np.zeros_like(course.part))
    return bank_of(whole, walks, bank.columns[:, columns])
