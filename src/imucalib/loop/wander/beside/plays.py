"""Whether a play or a creep of an axis explains as much as what it keeps of the posture before.

A share of the posture before and the side from which an axis came are the ends of one row of laws:
a reading that follows its input behind a play is off by half of it where the axis moved by more,
and by half of the move where it moved by less. What creeps to its new reading keeps less of the one
before the longer that is gone. A name is certain only where none of these does as well.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imucalib.arrays import Array
from imucalib.loop.found import Step
from imucalib.loop.wander.beside.parts import Rivals, held_against, parts_of
from imucalib.loop.wander.choice import Search
from imucalib.loop.wander.problem import Problem
from imucalib.units import STANDARD_GRAVITY

#: Widths of a play, g; the last holds every move.
_WIDTHS = (0.1, 0.3, 1.0, 2.0)
#: Times of a creep, in the median of those between two postures, and mg/g of it.
_FADED, _CREEP = (0.1, 0.3, 1.0, 3.0), 2.0
_HISTORY = "history"


def beside_plays(problem: Problem, found: Search, steps: Sequence[Step]) -> tuple[Step, ...]:
    """The steps; with the plays and creeps that would do as well in the place of what the posture
    before drives."""
    rivals, parts = Rivals(), parts_of(problem, found.bank)
    if "bias" in parts and any(taken.found.entry.kind == _HISTORY for taken in found.taken):
        moved = _moved(problem)
        for width in _WIDTHS:
            behind = np.clip(moved / (0.5 * width), -1.0, 1.0)
            rivals.add(f"play@{width:g}g", {f"play@{width:g}": parts["bias"] * behind})
        for late, kept in _kept(found.bank.course.time):
            creep = _CREEP * parts["bias"] * moved * kept[:, None]
            rivals.add(f"creep@{late:.3g}s", {f"creep@{late:.3g}": creep})
    return held_against(problem, found, steps, rivals)


def _moved(problem: Problem) -> Array:
    """(n, 3) g by which each axis moved from the posture before."""
    data = problem.small.observations
    before = np.stack([data.context[f"previous_{axis}"] for axis in "xyz"], axis=1)
    return np.asarray((data.reading[:, 0] - before) / STANDARD_GRAVITY)


def _kept(time: Array) -> list[tuple[float, Array]]:
    """Times of a creep (s), each with what it leaves from one of these times (n,) s to the next."""
    gone = np.diff(time, prepend=time[0])
    usual = max(float(np.median(gone[1:])), 1e-300) if gone.size > 1 else 1.0
    return [(share * usual, np.exp(-gone / (share * usual))) for share in _FADED]
