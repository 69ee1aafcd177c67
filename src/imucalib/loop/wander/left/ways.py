"""Every way in which structure may be left beside a search, in groups that stand by themselves."""

from __future__ import annotations

from imucalib.loop.wander.choice import Search
from imucalib.loop.wander.left.courses import courses
from imucalib.loop.wander.left.stretch import stretches
from imucalib.loop.wander.left.strongest import Way
from imucalib.loop.wander.left.swing import swings
from imucalib.loop.wander.problem import Problem


def ways_left(problem: Problem, found: Search) -> tuple[list[Way], list[Way]]:
    """Swings and courses of the whole recording, and stretches of it."""
    return [*swings(problem, found), *courses(problem, found)], stretches(problem, found)
