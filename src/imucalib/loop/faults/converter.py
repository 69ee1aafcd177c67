"""Readings that the converter did not give as they were: cut off at its range, or in wide steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index

#: Rows that must show the same extreme value, and by how much (mg) their other readings differ.
_REPEATS, _ELSEWHERE = 3, 30.0
#: Share of a range by which its two ends may differ: a count of 16 bits.
_COUNT = 5e-5
#: How far (mg) they must fall short of what they should be.
_BEYOND = 20.0
#: Steps (mg) that bury an ordinary noise, and the share of values that must lie on them.
_WIDE, _ON_STEPS = 3.0, 0.999


@dataclass(frozen=True)
class CutOff:
    """An axis that ends at a value. axis : 0..2; value : mg; rows : (m,) from 0."""

    axis: int
    value: float
    rows: Index


def rows_of(ends: Sequence[CutOff]) -> Index:
    """The rows, from 0, of all these ends."""
    return np.unique(np.concatenate([np.zeros(0, np.intp), *(end.rows for end in ends)]))


def cut_off(reading: Array, truth: Array | None = None) -> tuple[CutOff, ...]:
    """Extreme values (n, 3) mg that repeat exactly in rows whose other two readings differ; both
    ends of all axes have one range where their sizes are the same.

    truth : (n, 3) mg, known positions, whose linear map must lie beyond the value; without, |a| of
    those rows must fall short of the others'. Rounded readings on a ring repeat too; where nothing
    else repeats, the readings are finer than that, and no shortfall is asked for.
    """
    ends = [_end(reading, axis, side) for axis in range(3) for side in (-1.0, 1.0)]
    found: list[CutOff] = []
    for end in ends:
        alike = [e for e in ends if abs(abs(e.value) - abs(end.value)) <= _COUNT * abs(end.value)]
        rows = np.unique(np.concatenate([e.rows for e in alike]))
        others = np.delete(reading[end.rows], end.axis, axis=1)
        apart = len(alike) > 1 or np.ptp(others, axis=0).max() > _ELSEWHERE
        if len(rows) < _REPEATS or not apart:
            continue
        rest = np.setdiff1d(np.arange(len(reading)), rows)
        size = np.linalg.norm(reading, axis=1)
        short = float(np.median(size[rest]) - np.median(size[rows])) if rest.size else 0.0
        due = short if truth is None else _beyond(reading, truth, alike, rest)
        if due > _BEYOND or not _repeats(reading, alike):
            found.append(end)
    return tuple(found)


def _end(reading: Array, axis: int, side: float) -> CutOff:
    column = side * reading[:, axis]
    return CutOff(axis, side * float(column.max()), np.flatnonzero(column == column.max()))


def _repeats(reading: Array, ends: list[CutOff]) -> bool:
    """Whether any value of an axis stands in two rows, but at the ends that it is cut off at."""
    for axis in range(3):
        cut = [end.rows for end in ends if end.axis == axis]
        rest = np.delete(reading[:, axis], np.concatenate(cut)) if cut else reading[:, axis]
        if len(np.unique(rest)) < len(rest):
            return True
    return False


def _beyond(reading: Array, truth: Array, ends: list[CutOff], rest: Index) -> float:
    """How far (mg) the linear map of the other rows lies beyond the ends, in the median."""
    design = np.column_stack([truth, np.ones(len(truth))])
    if rest.size < 2 * design.shape[1]:
        return 0.0
    found = np.linalg.lstsq(design[rest], reading[rest], rcond=1e-6)[0]
    beyond = [np.sign(e.value) * (design[e.rows] @ found[:, e.axis] - e.value) for e in ends]
    return float(np.median(np.concatenate(beyond)))


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
