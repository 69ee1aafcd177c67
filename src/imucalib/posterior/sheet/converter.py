"""Readings that were not given as they were: cut off at a range, flattened, or in wide steps.

Readings of a converter at its range repeat exactly (`find_cut_offs`). An amplifier that saturates
leaves its noise on what it gives: no reading repeats, but all stop at one height (`flat_tops`).
What they should be follows from the rows away from every end: by the linear map where the positions
are known, else by the ellipsoid on which readings at rest lie.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.posterior.odds import (
    BEYOND,
    COUNT,
    ELLIPSOID,
    ELSEWHERE,
    NEAR_END,
    NUMBERS,
    ON_STEPS,
    REPEATS,
    ROW_NOISE,
    SENSITIVITY,
    SHORT,
    WIDE_STEP,
)

_NOWHERE = np.zeros((0, 3))
#: Scales that a guessed unit may hide: unit -> (counts a g, nominal counts a g of the unit).
_MISTAKEN = {"mg": ((1024.0, 1000.0), (980.665, 1000.0)), "ug": ((1048576.0, 1e6),)}


def flat_tops(reading: Array, truth: Array | None = None) -> tuple[CutOff, ...]:
    """Ends of readings (n, 3) mg at which rows stop that should read more.

    truth : (n, 3) mg, known positions; without, the size of gravity has to tell
    """
    along = np.concatenate([reading, -reading], axis=1)  # (n, 6), each end by itself
    height = along.max(axis=0)
    at = along > (1.0 - NEAR_END) * height
    rest = ~at.any(axis=1)
    due, sd = _by_map(reading, truth, rest) if truth is not None else _by_size(reading, rest)
    if not len(due):
        return ()
    short = np.concatenate([due, -due], axis=1) - along
    cut = at & (short > np.maximum(SHORT, BEYOND * sd)[:, None])
    if int(cut.sum()) < REPEATS:
        return ()
    found = []
    for end in np.flatnonzero(cut.any(axis=0)):
        rows = np.flatnonzero(at[:, end])
        level = float(np.median(along[rows, end]))
        found.append(CutOff(int(end) % 3, level if end < 3 else -level, rows))
    return tuple(found)


def _by_map(reading: Array, truth: Array, rest: Flags) -> tuple[Array, Array]:
    """(n, 3) mg by the linear map of the rest, and (n,) the standard deviation of that; nothing
    where they do not determine it."""
    design = np.column_stack([truth, np.ones(len(truth))])
    if int(rest.sum()) < NUMBERS * design.shape[1]:
        return _NOWHERE, np.zeros(0)
    found, _, rank, _ = np.linalg.lstsq(design[rest], reading[rest], rcond=1e-6)
    due = design @ found
    # What they leave open of the numbers fitted to them, which take some of their scatter too.
    inverse = np.linalg.pinv(design[rest].T @ design[rest], hermitian=True)
    leverage = np.einsum("ni,ij,nj->n", design, inverse, design)
    count, numbers = design[rest].shape
    widened = np.sqrt((1.0 + leverage) * count / max(count - numbers, 1))
    sd = _spread((reading - due)[rest]) * widened
    return (due if rank == numbers else _NOWHERE), np.asarray(sd)


def _by_size(reading: Array, rest: Flags) -> tuple[Array, Array]:
    """The same by the ellipsoid Σ a_k y_k² + b_k y_k + c_k y_{k+1} y_{k+2} = 1 of the rest, on
    which each axis is held against the other two, as data sheets know it before any row."""
    unit = float(np.median(np.linalg.norm(reading, axis=1)))
    if unit <= 0.0:
        return _NOWHERE, np.zeros(0)
    y = reading / unit
    across = np.roll(y, -1, axis=1) * np.roll(y, 1, axis=1)
    design = np.column_stack([y**2, y, across])
    own, known = design[rest] / ROW_NOISE, np.diag(np.repeat(ELLIPSOID, 3) ** -2.0)
    spread = np.linalg.inv(own.T @ own + known)
    found = spread @ (own.sum(axis=0) / ROW_NOISE + known @ np.repeat([1.0, 0.0, 0.0], 3))
    a, b, c = found[:3], found[3:6], found[6:]
    if a.min() <= 0.0:
        return _NOWHERE, np.zeros(0)
    # Of each axis a y² + slope y = left, with what the other two leave to it.
    slope = b + np.roll(c, 1) * np.roll(y, -1, axis=1) + np.roll(c, -1) * np.roll(y, 1, axis=1)
    left = 1.0 - ((design @ found)[:, None] - a * y**2 - slope * y)
    root = np.sqrt(np.maximum(slope**2 + 4.0 * a * left, 0.0))
    due = unit * np.where(y > 0.0, root - slope, -root - slope) / (2.0 * a)
    # About the ellipsoid a row is off along its normal, whose slope is about two.
    open_ = np.einsum("ni,ij,nj->n", design, spread, design)
    scatter = _spread(design[rest] @ found - 1.0) if rest.any() else 0.0
    return due, 0.5 * unit * np.sqrt(scatter**2 + open_)


def _spread(error: Array) -> float:
    return 1.4826 * float(np.median(np.abs(error)))


@dataclass(frozen=True)
class CutOff:
    """An axis that ends at a value. axis : 0..2; value : mg; rows : (m,) from 0."""

    axis: int
    value: float
    rows: Index


def rows_of(ends: Sequence[CutOff]) -> Index:
    """The rows, from 0, of all these ends."""
    return np.unique(np.concatenate([np.zeros(0, np.intp), *(end.rows for end in ends)]))


def find_cut_offs(reading: Array, truth: Array | None = None) -> tuple[CutOff, ...]:
    """Extreme values (n, 3) mg that repeat exactly in rows whose other two readings differ; both
    ends of all axes have one range where their sizes are the same.

    truth : (n, 3) mg, known positions, whose linear map must lie beyond the value; without, |a| of
    those rows must fall short of the others'. Rounded readings on a ring repeat too; where nothing
    else repeats, the readings are finer than that, and no shortfall is asked for.
    """
    ends = [
        CutOff(axis, float(value), np.flatnonzero(column == value))
        for axis, column in enumerate(reading.T)
        for value in (column.min(), column.max())
    ]
    found = list[CutOff]()
    for end in ends:
        alike = [e for e in ends if abs(abs(e.value) - abs(end.value)) <= COUNT * abs(end.value)]
        rows = np.unique(np.concatenate([e.rows for e in alike]))
        others = np.delete(reading[end.rows], end.axis, axis=1)
        apart = len(alike) > 1 or np.ptp(others, axis=0).max() > ELSEWHERE
        if len(rows) < REPEATS or not apart:
            continue
        rest = np.ones(len(reading), bool)
        rest[rows] = False
        size = np.linalg.norm(reading, axis=1)
        short = float(np.median(size[rest]) - np.median(size[rows])) if rest.any() else 0.0
        if truth is not None:
            due = _by_map(reading, truth, rest)[0]
            away = [np.sign(e.value) * (due[e.rows, e.axis] - e.value) for e in alike if len(due)]
            short = float(np.median(np.concatenate(away))) if away else 0.0
        if short > SHORT or not _repeats(reading, alike):
            found.append(end)
    return tuple(found)


def _repeats(reading: Array, ends: list[CutOff]) -> bool:
    """Whether any value of an axis stands in two rows, but at the ends that it is cut off at."""
    for axis in range(3):
        cut = [end.rows for end in ends if end.axis == axis]
        rest = np.delete(reading[:, axis], np.concatenate(cut)) if cut else reading[:, axis]
        if len(np.unique(rest)) < len(rest):
            return True
    return False


def step_of(reading: Array) -> float:
    """The step (mg) on which all readings (n, 3) lie, when it is wide; else 0."""
    values = np.unique(reading)
    apart = np.diff(values)
    if len(values) < 8:
        return 0.0
    step = float(apart.min())
    if step < WIDE_STEP:
        return 0.0
    on = np.abs((values - values[0]) / step - np.round((values - values[0]) / step)) < 1e-3
    return step if on.mean() >= ON_STEPS else 0.0


def find_mistaken_scale(unit: str, scale: Array) -> float | None:
    """Counts a g that the three axes' scale errors (3,) make likelier than the unit that was
    guessed from the size of the readings, or None. Sensitivities scatter by 1 % about either."""
    size = np.log1p(scale)
    best, counts = 0.0, None
    for per_g, nominal in _MISTAKEN.get(unit, ()):
        away = size - np.log(per_g / nominal)
        gain = 0.5 * float(size @ size - away @ away) / SENSITIVITY**2
        if gain > best:
            best, counts = gain, per_g
    return counts
