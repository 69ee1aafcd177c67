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
from imucalib.loop.thresholds import MARGIN, STRONG
from imucalib.loop.wander.bank import Bank, bank_of
from imucalib.loop.wander.beside.parts import Rivals, held_against
from imucalib.loop.wander.choice import Search, Taken
from imucalib.loop.wander.likelihood import Terms, levels
from imucalib.loop.wander.problem import Problem
from imucalib.loop.wander.walk import Course, Walk
from imucalib.loop.wander.words import PAST
from imucalib.units import MG, STANDARD_GRAVITY

#: Memories of a slow walk in recordings, and its variances over a run's, as fine as the search's.
_TAU, _RHO = (0.5, 2.0), (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0)
#: What stands beside an effect that a slow walk of the bias, or of the scale, imitates.
WANDERING, _OF_SCALE = "wandering_bias", "wandering_scale"
_CLOCK, _DAY, _HARMONICS = "time_of_day", 86400.0, 2


def beside_slow_walks(problem: Problem, found: Search, steps: Sequence[Step]) -> tuple[Step, ...]:
    """The steps; with those that do not lead a slow walk by three nats, alone or all together, what
    wanders there. A temperature that moves within hours is a course of time as well, and its past
    one of thirteen, which has to lead by ten."""
    moved = [taken for taken in found.taken if not taken.found.entry.of_response]
    wanders = _wanders(problem, found.bank) if moved else {}

    def led(some: Sequence[Taken]) -> list[str]:
        others = problem.terms
        for other in found.taken:
            if not any(other is one for one in some):
                others = others.plus(other.found.entry.columns, other.size)
        past = any(one.found.entry.name.partition("@")[0] in PAST for one in some)
        least = STRONG if past else MARGIN
        return [w for w, seen in wanders.items() if lead(found.bank, others, some, seen) < least]

    every = led(moved) if len(moved) > 1 else []
    out = list[Step]()
    for taken, step in zip(found.taken, steps, strict=True):
        if any(taken is one for one in moved):
            names = dict.fromkeys((*step.aliases, *led([taken]), *every))
            step = replace(step, aliases=tuple(names))  # noqa: PLW2901
        out.append(step)
    return tuple(out)


def _wanders(problem: Problem, bank: Bank) -> dict[str, Array]:
    """What may wander slowly, with what |a| sees of it, (n, q): the bias with a common scale, as in
    the search, and the bias with the scale of each axis (1 mg/g)."""
    seen, scales = bank.course.seen, _scale_columns(problem, bank) * problem.noise.scatter
    found = {WANDERING: seen}
    if scales.size:
        found[_OF_SCALE] = np.column_stack([seen[:, :3], scales])
    return found


def lead(bank: Bank, others: Terms, some: Sequence[Taken], seen: Array) -> float:
    """Nats by which effects beside other terms lead the likeliest slow walk without them.

    seen : (n, q) what |a| sees of the slow walks
    """
    columns = np.concatenate([others.columns, *(taken.found.entry.columns for taken in some)])
    every, slow = np.append(columns, bank.data), slower(bank)
    at, keep = np.arange(columns.size), np.ones(1, dtype=bool)
    without = Terms(at[: others.columns.size], others.precision, others.base)
    within, start = without, others.columns.size
    for taken in some:
        stop = start + taken.found.entry.columns.size
        within, start = within.plus(at[start:stop], taken.size), stop
    one = through(bank, bank.walks, every)
    with_it, known = (max(x.nats for x in levels(one, t, keep)) for t in (within, without))
    course = replace(bank.course, seen=seen)
    rest = levels(through(replace(bank, course=course), slow, every), without, keep)
    return with_it - max(known, *(x.nats for x in rest))


def slower(bank: Bank) -> tuple[Walk, ...]:
    """Walks that remember longer than those of a search."""
    span = float(np.ptp(bank.course.time))
    return tuple(Walk(rho, share * span) for share in _TAU for rho in _RHO)


def through(bank: Bank, walks: tuple[Walk, ...], columns: Array) -> Bank:
    """Some of the columns under walks that never begin anew."""
    course = bank.course
    whole = Course(course.time, course.seen, course.variance, np.zeros_like(course.part))
    return bank_of(whole, walks, bank.columns[:, columns])


def beside_the_day(problem: Problem, found: Search, steps: Sequence[Step]) -> tuple[Step, ...]:
    """The steps; with those that a swing of the day explains as well, where the search had none."""
    if not steps or _CLOCK in problem.small.observations.context:
        return tuple(steps)
    rivals = Rivals()
    for name, columns in _swings(problem).items():
        rivals.add(name, {name: columns})
    return held_against(problem, found, steps, rivals)


def _scale_columns(problem: Problem, bank: Bank) -> Array:
    """(n, 3) what |a| sees of the scale of each axis (1 mg/g), in units of the scatter; or (n, 0)
    where the base model has no scale."""
    fit = problem.fit
    slices = fit.model.slices(fit.observations.context)
    if "scale" not in slices:
        return bank.columns[:, :0]
    typical = np.array([p.typical for p in fit.parameters[slices["scale"]]])
    return np.asarray(bank.columns[:, slices["scale"]] * (MG / STANDARD_GRAVITY / typical))


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
