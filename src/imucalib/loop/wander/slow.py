"""Whether what is slower than the recording does as well as what was taken: a bias that wanders,
and the day.

The noise of the search forgets within a sixth of the recording; a drift, a step, a warm-up and a
daily swing last longer, and so does a slow walk, which is none of them. Here the walk goes on
through the whole recording:

    lead = max over the search's walks of L(with the effect) - max over slower ones of L(without)

What swings once a day is no candidate where less than one and a half days were seen: half a day of
it is a drift, and no recording of half a day can tell them apart. No day is a pure sine; a wave of
24 h with its harmonic holds a straight line over twelve hours but for 2 % of it, over a whole day
but for a half.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.effects import catalogue
from imucalib.loop.candidates import effect_candidates
from imucalib.loop.found import Step
from imucalib.loop.noise.shared import WANDERING
from imucalib.loop.thresholds import MARGIN
from imucalib.loop.wander.bank import Bank, bank_of
from imucalib.loop.wander.choice import Search, Taken
from imucalib.loop.wander.likelihood import Terms, levels
from imucalib.loop.wander.problem import Problem
from imucalib.loop.wander.scores import Entry
from imucalib.loop.wander.walk import Course, Walk
from imucalib.loop.wander.words import with_rivals
from imucalib.units import MG

#: Memories of a slow walk in recordings, and its variances over a run's, as fine as the search's.
_TAU, _RHO = (0.5, 2.0), (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0)
_CLOCK, _DAY, _HARMONICS = "time_of_day", 86400.0, 2


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


def beside_the_day(problem: Problem, found: Search, steps: Sequence[Step]) -> tuple[Step, ...]:
    """The steps; with those that a swing of the day explains as well, where the search had none."""
    if not steps or _CLOCK in problem.small.observations.context:
        return tuple(steps)
    swings = _swings(problem)
    bank, start = found.bank, found.bank.columns.shape[1]
    entries = list[Entry]()
    for name, columns in swings.items():
        at = start + np.arange(columns.shape[1])
        entries.append(Entry(name, "", "time", at))
        start += at.size
    bank = bank.plus(np.concatenate(list(swings.values()), axis=1))
    return with_rivals(problem, replace(found, bank=bank), steps, entries)


def _swings(problem: Problem) -> dict[str, Array]:
    """Columns (n, c) of a wave of 24 h and its harmonics by what swings, of whatever phase."""
    data, unit = problem.small.observations, problem.small.at.sigma[:, :1] / MG
    context, found = data.context, dict[str, Array]()
    effects = [e for e in catalogue().values() if e.needs == (_CLOCK,)]
    for harmonic in range(1, _HARMONICS + 1):
        angle = 2.0 * np.pi * harmonic * context["time"] / _DAY
        own = replace(context, covariates={**context.covariates, _CLOCK: angle})
        small = replace(problem.small, observations=replace(data, context=own))
        for one in effect_candidates(small, effects)[0]:
            columns = one.columns * unit / problem.noise.scatter
            before = found.get(one.name, columns[:, :0])
            found[one.name] = np.column_stack([before, columns])
    return found
