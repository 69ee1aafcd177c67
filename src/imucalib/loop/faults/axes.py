"""Readings whose axes are exchanged or inverted in a part of the sheet.

Every signed permutation Q, in all rows from k on, at every k; with y the readings and z = Q y,

    RSS(k, Q) = Σ_{i,j<k} y_i P_ij y_j + 2 Σ_{i<k≤j} y_i P_ij z_j + Σ_{i,j≥k} z_i P_ij z_j

is a sum over corners of three tables.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations, product

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.loop.faults.base import Base, prior_of
from imucalib.loop.faults.conventions import axes_text, nearest_axes
from imucalib.loop.faults.found import Fault, Hypothesis
from imucalib.loop.faults.readings import by_rows, leading
from imucalib.loop.faults.sheet import Sheet

#: Rows that a part has at least: of a single one, its cells are asked.
_LEAST = 2
#: Of gravity, what the other axes must move one reading by: an axis that stands level all the while
#: reads a few mg, and a drift does as much.
_MOVED = 0.05
_AXES = tuple(
    (np.array(order), np.array(sign))
    for order in permutations(range(3))
    for sign in product((1.0, -1.0), repeat=3)
    if (order, sign) != ((0, 1, 2), (1.0, 1.0, 1.0))
)


def other_axes(base: Base) -> list[Hypothesis]:
    """Readings whose axes are exchanged or inverted from some row on, or up to it."""
    sheet = base.sheet
    if not sheet.ordered or sheet.n < 2 * _LEAST:
        return []
    at = np.arange(_LEAST, sheet.n - _LEAST + 1)
    count = 2.0 * len(_AXES) * len(at)
    turned = np.stack([sheet.reading[:, order] * sign for order, sign in _AXES])
    few = base.at(base.few)
    if not leading(few.gain(_corners(few, turned)[:, :, at], count).ravel()).size:
        return []
    score = base.gain(_corners(base, turned)[:, :, at], count)
    found = []
    for k in leading(score.ravel()):
        which, start = divmod(int(k), len(at))
        one = _turned(sheet, which, int(at[start]), float(score[which, start]))
        one = replace(one, prior=prior_of(count))
        if np.abs(one.repaired.reading - sheet.reading).max() > _MOVED * sheet.gravity:
            found.append(one)
    return found


def _corners(base: Base, z: Array) -> Array:
    """(G, Q, n + 1) RSS with the rows from k on read as z (Q, n, 3)."""
    y, n = base.sheet.reading, base.sheet.n
    found = np.empty((len(base.rss), len(z), n + 1))
    blocks, _ = by_rows(base)
    for point, P in enumerate(blocks):  # (n, n, 3, 3)
        to_y = np.einsum("ia,ijab->ijb", y, P)
        to_z = np.einsum("qia,ijab->qijb", z, P, optimize=True)
        own = np.einsum("ijb,jb->ij", to_y, y)
        both = np.einsum("ijb,qjb->qij", to_y, z)
        new = np.einsum("qijb,qjb->qij", to_z, z, optimize=True)
        found[point] = (
            _before(own)[None] + 2.0 * _across(both) + _before(new[:, ::-1, ::-1])[:, ::-1]
        )
    return found


def _before(table: Array) -> Array:
    """(..., n + 1) sums of the leading k by k corners of (..., n, n)."""
    sums = table.cumsum(axis=-1).cumsum(axis=-2)
    corner = np.diagonal(sums, axis1=-2, axis2=-1)
    return np.concatenate([np.zeros_like(corner[..., :1]), corner], axis=-1)


def _across(table: Array) -> Array:
    """(..., n + 1) sums over rows before k and columns from k on."""
    above = table.cumsum(axis=-2)
    right = above[..., ::-1].cumsum(axis=-1)[..., ::-1]
    inner = np.diagonal(right[..., :-1, 1:], axis1=-2, axis2=-1)
    none = np.zeros_like(table[..., 0, :1])
    return np.concatenate([none, inner, none], axis=-1)


def _turned(sheet: Sheet, which: int, start: int, score: float) -> Hypothesis:
    """Which of the two parts is wrong no likelihood says: the one whose mending lets the sensor
    stand straight, else the shorter one."""
    order, sign = _AXES[which]
    back = np.argsort(order)
    parts = [
        (np.arange(start, sheet.n), order, sign),
        (np.arange(start), back, sign[back]),
    ]
    parts.sort(key=lambda part: len(part[0]))
    mended = [_read_so(sheet, *part) for part in parts]
    straight = [(axes := nearest_axes(one)) is not None and axes.straight for one in mended]
    best = straight.index(True) if True in straight else 0
    rows, order, sign = parts[best]
    text = axes_text(order, sign)
    first, last = int(sheet.row[rows[0]]), int(sheet.row[rows[-1]])
    what = f"rows {first} to {last}: their x, y, z are the others' {text}"
    touched = tuple(int(row) for row in sheet.row[rows])
    fault = Fault("axes", what, touched, score, f"--axes={first}-{last}:{text}")
    return Hypothesis(fault, mended[best])


def _read_so(sheet: Sheet, rows: Index, order: Index, sign: Array) -> Sheet:
    reading = sheet.reading.copy()
    reading[rows] = reading[rows][:, order] * sign
    return sheet.with_reading(reading)
