"""Whether another course of the same driver explains as much as a name's.

A straight drift is one course of the time, a sine one of the day, a straight line one of the
temperature. Beside a name stand free courses of its driver, of every part of the base model, and
the name is certain only where none of them explains more: their further numbers cost a true name
some nats, and pay where its form is another. What the scale makes of the temperature's past stands
beside what follows the temperature now.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from imucalib.arrays import Array
from imucalib.core.context import Context
from imucalib.effects.thermal import hysteresis, lag
from imucalib.loop.found import Step
from imucalib.loop.wander.beside.parts import Rivals, driven, held_against, parts_of
from imucalib.loop.wander.choice import Search
from imucalib.loop.wander.problem import Problem
from imucalib.loop.wander.scores import Entry

#: mg, mg/g of a course; its waves over the range of the driver, rougher ones smaller, and of a day.
_SIZE, _TERMS, _HARMONICS = 2.0, 4, 3
#: Drifts that a straight line is not: they settle, or grow.
_POWERS = {0.5: "root", 2.0: "square"}
_CLOCK, _WARM = "time_of_day", "temperature"
#: What else of the temperature a scale may follow, which no candidate's scale does.
_PAST = {lag.PREFIX: "scale_lag", hysteresis.PREFIX: "scale_hysteresis"}


def beside_courses(problem: Problem, found: Search, steps: Sequence[Step]) -> tuple[Step, ...]:
    """The steps with the courses of their drivers that would do as well in the place of each."""
    context = problem.small.observations.context
    parts, rivals = parts_of(problem, found.bank), Rivals()
    for driver, drives in _drives(found, context).items():
        for word, columns in parts.items():
            name = f"{word}_over_{driver}"
            rivals.add(name, {name: driven(columns, _SIZE * drives)}, wide=True)
    if any(_driver(taken.found.entry) == "time" for taken in found.taken):
        share = within(found.bank.course.time)
        for word, power in product(("bias", "scale"), _POWERS):
            name, drive = f"{word}_{_POWERS[power]}_of_time", share[:, None] ** power
            if word in parts:
                rivals.add(name, {name: driven(parts[word], _SIZE * drive)}, wide=True)
    if "scale" in parts and any(_driver(taken.found.entry) == _WARM for taken in found.taken):
        for name, drive in _of_the_past(context).items():
            rivals.add(name, {name: driven(parts["scale"], drive)})
    return held_against(problem, found, steps, rivals)


def _of_the_past(context: Context) -> dict[str, Array]:
    """(n, 1) °C about the mean of the temperature behind every lag and play, by a scale's name."""
    found = dict[str, Array]()
    for prefix, word in _PAST.items():
        for name in (name for name in context.covariates if name.startswith(prefix)):
            late = context[name][:, None]
            found[f"{word}@{name.removeprefix(prefix)}"] = np.asarray(late - late.mean())
    return found


def _drives(found: Search, context: Context) -> dict[str, Array]:
    """(n, k) courses of the drivers of what was taken, by words for them."""
    kinds = {_driver(taken.found.entry) for taken in found.taken}
    drives = dict[str, Array]()
    if "time" in kinds:
        drives["time"] = waves(found.bank.course.time, _TERMS)
    if _CLOCK in kinds and _CLOCK in context:
        k = np.arange(1, _HARMONICS + 1) * context[_CLOCK][:, None]
        drives["the_day"] = np.concatenate([np.cos(k), np.sin(k)], axis=1)
    if _WARM in kinds and _WARM in context:
        drives[_WARM] = waves(context[_WARM], _TERMS)
    return drives


def within(values: Array) -> Array:
    """(n,) place in the range of a covariate, 0 to 1."""
    return np.asarray((values - values.min()) / max(float(np.ptp(values)), 1e-300))


def _driver(entry: Entry) -> str:
    return _CLOCK if entry.name.endswith(_CLOCK) else entry.kind


def waves(values: Array, terms: int) -> Array:
    """(n, terms) cosines over the range of a covariate, rougher ones smaller."""
    unit = within(values)
    k = np.arange(1, terms + 1)
    return np.asarray(np.sqrt(2.0) * np.cos(np.pi * k * unit[:, None]) / k)
