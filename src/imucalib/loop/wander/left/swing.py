"""Swings with a period that no effect names, of the bias or of the scale.

A swing of some hours is to the noise a bias that wanders: the walk takes it over, and nothing is
missing. But a walk has no period; what has one is structure.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from imucalib.arrays import Array
from imucalib.loop.wander.beside.parts import parts_of
from imucalib.loop.wander.choice import Search
from imucalib.loop.wander.left.strongest import Way
from imucalib.loop.wander.problem import Problem

#: Swings in a recording: three at least, else it is anything that passes; at most sixty, about as
#: quick as the shortest walk, and one in five runs; steps between which a wave keeps nine tenths.
_FEWEST, _MOST, _RUNS, _STEP = 3.0, 60.0, 5.0, 0.5
#: What may swing: parts of the base model.
_SWINGS = ("bias", "scale")


def swings(problem: Problem, found: Search) -> list[Way]:
    """Of whatever phase, with every period that the recording can show."""
    time = found.bank.course.time
    parts = even_parts(problem, found)
    some = {name: parts[name] for name in _SWINGS if name in parts}
    return [
        Way(
            _words(name, time, count), "time", "swing", _waves(columns, time, count),
            effect=f"shape@{name}:time:sine:{np.ptp(time) / count:.6g}",
        )
        for (name, columns), count in product(some.items(), _counts(time))
    ]  # fmt: skip


def even_parts(problem: Problem, found: Search) -> dict[str, Array]:
    """Parts of the base model, (n, c), one in the mean of every column."""
    every = parts_of(problem, found.bank)
    # An axis that no posture shows has a column of nothing, and keeps it.
    return {word: x / np.sqrt(np.mean(x**2, axis=0) + 1e-300) for word, x in every.items()}


def _words(name: str, time: Array, count: float) -> str:
    return f"the {name} swings with a period of {np.ptp(time) / count / 3600.0:.2g} h"


def _counts(time: Array) -> Array:
    """(k,) swings in the recording."""
    return np.arange(_FEWEST, min(_MOST, time.size / _RUNS), _STEP)


def _waves(columns: Array, time: Array, count: float) -> Array:
    angle = 2.0 * np.pi * count * ((time - time[0]) / np.ptp(time))[:, None]
    return np.column_stack([columns * np.cos(angle), columns * np.sin(angle)])
