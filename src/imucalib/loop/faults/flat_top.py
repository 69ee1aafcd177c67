"""Readings that stay at an end while the position asks for more: saturation before the noise.

An amplifier that saturates leaves its noise on what it gives: no reading repeats, as those of a
converter at its range do (`converter.cut_off`), but all stop at one height. What they should be
follows from the rows away from every end: by the linear map where the positions are known, else
by the ellipsoid on which readings at rest lie.
"""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.loop.faults.converter import CutOff

#: Share of an end's height within which readings are at it; mg by which they fall short there, at
#: least, and times what the other rows, few or far from there, leave open of what they should be.
_NEAR, _SHORT, _CLEAR = 0.01, 20.0, 8.0
#: Rows that must fall short, and numbers of the others for each number that is fitted to them.
_FEWEST, _TIMES = 3, 2
_NOWHERE = np.zeros((0, 3))
#: What data sheets let the squares, middles and angles of the ellipsoid be off by, twice the worst;
#: and the noise of a row's square over that of gravity.
_SHEET, _ROW = np.array([0.06, 0.2, 0.04]), 2e-3


def flat_tops(reading: Array, truth: Array | None = None) -> tuple[CutOff, ...]:
    """Ends of readings (n, 3) mg at which rows stop that should read more.

    truth : (n, 3) mg, known positions; without, the size of gravity has to tell
    """
    along = np.concatenate([reading, -reading], axis=1)  # (n, 6), each end by itself
    height = along.max(axis=0)
    at = along > (1.0 - _NEAR) * height
    rest = ~at.any(axis=1)
    due, sd = _by_map(reading, truth, rest) if truth is not None else _by_size(reading, rest)
    if not len(due):
        return ()
    short = np.concatenate([due, -due], axis=1) - along
    cut = at & (short > np.maximum(_SHORT, _CLEAR * sd)[:, None])
    if int(cut.sum()) < _FEWEST:
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
    if int(rest.sum()) < _TIMES * design.shape[1]:
        return _NOWHERE, np.zeros(0)
    found, _, rank, _ = np.linalg.lstsq(design[rest], reading[rest], rcond=1e-6)
    due = design @ found
    sd = _spread((reading - due)[rest]) * _open(design, rest)
    return (due if rank == design.shape[1] else _NOWHERE), sd


def _by_size(reading: Array, rest: Flags) -> tuple[Array, Array]:
    """The same by the ellipsoid Σ a_k y_k² + b_k y_k + c_k y_{k+1} y_{k+2} = 1 of the rest, on
    which each axis is held against the other two, as data sheets know it before any row."""
    unit = float(np.median(np.linalg.norm(reading, axis=1)))
    if unit <= 0.0:
        return _NOWHERE, np.zeros(0)
    y = reading / unit
    across = np.roll(y, -1, axis=1) * np.roll(y, 1, axis=1)
    design = np.column_stack([y**2, y, across])
    own, known = design[rest] / _ROW, np.diag(np.repeat(_SHEET, 3) ** -2.0)
    spread = np.linalg.inv(own.T @ own + known)
    found = spread @ (own.sum(axis=0) / _ROW + known @ np.repeat([1.0, 0.0, 0.0], 3))
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


def _open(design: Array, rest: Flags) -> Array:
    """(n,) standard deviation of a row's prediction by the rest, over the rest's scatter: what they
    leave open of the numbers that are fitted to them, which take some of that scatter too."""
    own = design[rest]
    inverse = np.linalg.pinv(own.T @ own, hermitian=True)
    leverage = np.einsum("ni,ij,nj->n", design, inverse, design)
    count, numbers = own.shape
    return np.asarray(np.sqrt((1.0 + leverage) * count / max(count - numbers, 1)))


def _spread(error: Array) -> float:
    return 1.4826 * float(np.median(np.abs(error)))
