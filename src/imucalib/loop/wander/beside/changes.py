"""Whether something else that changes at a moment does as well as what time drives.

A step of the bias, of the scale, of the angles between the axes, and of what the bias makes of the
temperature are one thing to a search that knows the first alone: something changes at this moment.
What changes is weighed here. A change of all nine parameters holds a step of the bias, so that it
is a rival by its evidence alone: its six further numbers cost an effect that has none of them five
nats at least, and pay where the scale jumps too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.loop.found import Step
from imucalib.loop.thresholds import MARGIN
from imucalib.loop.wander.beside.parts import Rivals, driven, held_against, narrowed, parts_of
from imucalib.loop.wander.choice import Search
from imucalib.loop.wander.noise import usable_walks
from imucalib.loop.wander.problem import Problem
from imucalib.loop.wander.scores import Entry, scored

#: Parts of the recording between which a jump is held against what was taken.
_JUMPS = 32
#: mg, mg/g: what a jump is like.
_SIZE = 2.0
_STEP = "bias_step"
#: Times of recovery, as shares of what is left of the recording: a knock relaxes, and one that
#: takes far longer than was seen is a step.
_RECOVERED = (0.3, 1.0)


def beside_changes(problem: Problem, found: Search, steps: Sequence[Step]) -> tuple[Step, ...]:
    """The steps; where time drives one, with what else may change at a moment in its place, or in
    the place of all that time drives."""
    timed = [taken for taken in found.taken if taken.found.entry.timed]
    rivals = _changes(problem, found) if timed else Rivals()
    if not rivals.made:
        return tuple(steps)
    told = held_against(problem, found, steps, rivals)
    one = _instead_of_all(problem, found, rivals) if len(timed) > 1 else ""
    if not one:
        return told
    return tuple(
        _with(step, one) if taken.found.entry.timed else step
        for taken, step in zip(found.taken, told, strict=True)
    )


def _with(step: Step, name: str) -> Step:
    known = {alias.partition("@")[0] for alias in step.aliases}
    more = () if name.partition("@")[0] in known else (name,)
    return replace(step, aliases=(*step.aliases, *more))


def _changes(problem: Problem, found: Search) -> Rivals:
    """Of every part of the base model, of all together, and of what the temperature does."""
    bank, rivals = found.bank, Rivals()
    parts = parts_of(problem, bank)
    warm = _warmth(problem)
    for at in _moments(found):
        late = np.where(bank.course.time >= at, _SIZE, 0.0)[:, None]
        own = {f"{word}@{at}": driven(columns, late) for word, columns in parts.items()}
        for word in ("scale", "axes"):
            key = f"{word}@{at}"
            rivals.add(f"{word}_step@{at:.0f}s", {key: own[key]} if key in own else {})
        if "bias" in parts:
            for hours, drive in _recoveries(bank.course.time, at):
                name = f"recovering_step@{at:.0f}s:{hours:.3g}h"
                rivals.add(name, {name: driven(parts["bias"], drive)})
        if len(own) > 1:
            rivals.add(f"calibration_step@{at:.0f}s", own, wide=True)
        if warm.size and "bias" in parts:
            key = f"warm@{at}"
            both = {f"bias@{at}": own[f"bias@{at}"], key: driven(parts["bias"], late * warm)}
            rivals.add(f"temperature_step@{at:.0f}s", both, wide=True)
    return rivals


def _recoveries(time: Array, at: float) -> list[tuple[float, Array]]:
    """Hours of recovery from a jump at a moment (s), each with its course (n, 1), times (n,) s."""
    since = np.maximum(time - at, 0.0)
    late, left = time >= at, max(float(time[-1]) - at, 1e-300)
    return [
        (
            share * left / 3600.0,
            np.where(late, _SIZE * np.exp(-since / (share * left)), 0.0)[:, None],
        )
        for share in _RECOVERED
    ]


def _moments(found: Search) -> list[float]:
    """Seconds: evenly among the runs, and where the bias was found to jump."""
    every = np.quantile(found.bank.course.time, np.arange(1, _JUMPS) / _JUMPS)
    names = [taken.found.entry.name for taken in found.taken]
    own = [float(n.partition("@")[2][:-1]) for n in names if n.startswith(f"{_STEP}@")]
    return [*own, *every]


def _warmth(problem: Problem) -> Array:
    """(n, 1) °C about the mean, or nothing."""
    context = problem.small.observations.context
    if "temperature" not in context:
        return np.zeros((0, 1))
    warm = context["temperature"]
    return np.asarray(warm - np.mean(warm))[:, None]


def _instead_of_all(problem: Problem, found: Search, rivals: Rivals) -> str:
    """The change that explains as much as everything together that time drives; else nothing."""
    search = narrowed(problem.terms, found)
    columns, entries = rivals.entries(search.bank.columns.shape[1])
    bank, terms = search.bank.plus(columns), problem.terms
    own = list[Index]()
    for taken in search.taken:
        entry = taken.found.entry
        if entry.timed:
            own.append(entry.columns)
        else:
            terms = terms.plus(entry.columns, taken.size)
    together = Entry("", "", "time", np.concatenate(own))
    keep, walks = (
        np.ones(bank.course.parts, dtype=bool),
        usable_walks(bank, found.level, same_tau=False),
    )
    scores, _ = scored(bank, terms, keep, [together, *entries], walks, told=False)
    least = next(s.evidence for s in scores if s.entry is together) - MARGIN
    return next((s.entry.name for s in scores if s.entry.wide and s.evidence >= least), "")
