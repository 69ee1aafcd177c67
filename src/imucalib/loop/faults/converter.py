"""Readings that the converter did not give as they were: cut off at its range, or in wide steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Rows that must show the same extreme value, and by how much (mg) their other readings differ.
_REPEATS, _ELSEWHERE = 3, 30.0
#: Steps (mg) that bury an ordinary noise, and the share of values that must lie on them.
_WIDE, _ON_STEPS = 3.0, 0.999


@dataclass(frozen=True)
class CutOff:
    """An axis that ends at a value. axis : 0..2; value : mg; rows : (m,) from 0."""

    axis: int
    value: float
    rows: Index


def cut_off(reading: Array) -> tuple[CutOff, ...]:
    """Extreme values (n, 3) mg that repeat exactly in rows whose other two readings differ.

    Two rows of one position may repeat a rounded value; three in different positions do not.
    """
    found = []
    for axis in range(3):
        column = reading[:, axis]
        for end in (float(column.min()), float(column.max())):
            rows = np.flatnonzero(column == end)
            others = np.delete(reading[rows], axis, axis=1)
            if len(rows) >= _REPEATS and np.ptp(others, axis=0).max() > _ELSEWHERE:
                values, count = np.unique(np.delete(column, rows), return_counts=True)
                if not len(values) or count.max() < _REPEATS:
                    found.append(CutOff(axis, end, rows))
    return tuple(found)


def step_of(reading: Array) -> float:
    """The step (mg) on which all readings (n, 3) lie, when it is wide; else 0."""
    values = np.unique(reading)
    apart = np.diff(values)
    if len(values) < 8:
        return 0.0
    step = float(apart.min())
    if step < _WIDE:
        return 0.0
    on = np.abs((values - values[0]) / step - np.round((values - values[0]) / step)) < 1e-3
    return step if on.mean() >= _ON_STEPS else 0.0


#: Scales that a guessed unit may hide: unit -> (counts a g, nominal counts a g of the unit).
_MISTAKEN = {"mg": ((1024.0, 1000.0), (980.665, 1000.0)), "ug": ((1048576.0, 1e6),)}
#: Scatter of the sensitivities of an accelerometer's axes, relative.
_SENSITIVITY = 0.01


def mistaken_scale(unit: str, scale: Array) -> float | None:
    """Counts a g that the three axes' scale errors (3,) make likelier than the unit that was
    guessed from the size of the readings, or None. Sensitivities scatter by 1 % about either."""
    size = np.log1p(scale)
    best, counts = 0.0, None
    for per_g, nominal in _MISTAKEN.get(unit, ()):
        away = size - np.log(per_g / nominal)
        gain = 0.5 * float(size @ size - away @ away) / _SENSITIVITY**2
        if gain > best:
            best, counts = gain, per_g
    return counts
