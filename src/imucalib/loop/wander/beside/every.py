"""Every rival of the names that a search has taken, in the order in which they are looked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imucalib.core.fit import Fit
from imucalib.loop.found import Step
from imucalib.loop.wander.beside.changes import beside_changes
from imucalib.loop.wander.beside.courses import beside_courses
from imucalib.loop.wander.beside.plays import beside_plays
from imucalib.loop.wander.choice import Search
from imucalib.loop.wander.problem import Problem
from imucalib.loop.wander.slow import beside_slow_walks, beside_the_day
from imucalib.loop.wander.words import UNLISTED, beside_others

_SURE = 2.0  # standard errors


def beside_all(
    problem: Problem, found: Search, steps: Sequence[Step], final: Fit
) -> tuple[Step, ...]:
    """The steps with all that would do as well in the place of each. final : the fit with them"""
    steps = beside_others(problem, found, steps)
    steps = beside_the_day(problem, found, steps)
    steps = beside_changes(problem, found, steps)
    steps = beside_courses(problem, found, steps)
    steps = beside_plays(problem, found, steps)
    steps = unsure_together(beside_slow_walks(problem, found, steps))
    return tuple(
        replace(step, aliases=tuple(dict.fromkeys((*step.aliases, UNLISTED))))
        if beyond_usual(final, step.effect)
        else step
        for step in steps
    )


def unsure_together(steps: Sequence[Step]) -> tuple[Step, ...]:
    """The steps; with what may stand in the place of another one as well, that other: a jump of the
    bias beside a lag that may be such a jump is found only if it is none."""
    return tuple(
        replace(step, aliases=tuple(dict.fromkeys((*step.aliases, *_who_may_be(step, steps)))))
        for step in steps
    )


def _who_may_be(step: Step, steps: Sequence[Step]) -> list[str]:
    own = step.effect.partition("@")[0]
    return [
        other.effect
        for other in steps
        if other is not step and own in {name.partition("@")[0] for name in other.aliases}
    ]


def beyond_usual(fit: Fit, name: str) -> bool:
    """Whether an effect of a fit is surely larger than data sheets let one expect."""
    part = fit.model.slices(fit.observations.context).get(name, slice(0))
    sure = np.abs(fit.theta[part]) - _SURE * fit.sd[part]
    usual = np.array([p.usual for p in fit.parameters[part]])
    return bool(np.any(sure > usual))
