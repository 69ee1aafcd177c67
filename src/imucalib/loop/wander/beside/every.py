"""Every rival of the names that a search has taken, in the order in which they are looked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from imucalib.core.fit import Fit
from imucalib.loop.found import Step
from imucalib.loop.rivals import UNLISTED, beyond_usual
from imucalib.loop.wander.beside.changes import beside_changes
from imucalib.loop.wander.beside.courses import beside_courses
from imucalib.loop.wander.choice import Search
from imucalib.loop.wander.problem import Problem
from imucalib.loop.wander.slow import beside_slow_walks, beside_the_day
from imucalib.loop.wander.words import beside_others


def beside_all(
    problem: Problem, found: Search, steps: Sequence[Step], final: Fit
) -> tuple[Step, ...]:
    """The steps with all that would do as well in the place of each. final : the fit with them"""
    steps = beside_others(problem, found, steps)
    steps = beside_the_day(problem, found, steps)
    steps = beside_changes(problem, found, steps)
    steps = beside_courses(problem, found, steps)
    steps = beside_slow_walks(problem, found, steps)
    return tuple(
        replace(step, aliases=(*step.aliases, UNLISTED))
        if beyond_usual(final, step.effect)
        else step
        for step in steps
    )
