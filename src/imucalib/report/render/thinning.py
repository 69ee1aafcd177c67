"""Long series cut to what a drawing can show, without losing an extreme or a gap."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array

Indices = NDArray[np.intp]

LONGEST = 2000  # points drawn one by one; beyond, extremes of buckets


def thinned(x: Array, y: Array) -> Indices:
    """Indices, ascending, of the points to draw: all, or first, last and bucket extremes of x, y.

    The number kept is bounded by about two times `LONGEST`; gaps are not among them.
    """
    good = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if good.size <= LONGEST:
        return good
    buckets = LONGEST // 2
    size = -(-good.size // buckets)
    rows = np.concatenate([good, np.full(-good.size % size, good[-1])]).reshape(-1, size)
    extremes = [pick(values[rows], axis=1) for values in (x, y) for pick in (np.argmin, np.argmax)]
    ends = [good[:1], good[-1:]]
    return np.unique(np.concatenate([rows[np.arange(len(rows)), c] for c in extremes] + ends))


def runs(keep: Indices, broken: NDArray[np.bool_]) -> list[Indices]:
    """The kept indices split where a gap (`broken`, bool (n,)) lies between two neighbours."""
    if keep.size == 0:
        return []
    gaps = np.cumsum(broken)
    return np.split(keep, np.flatnonzero(np.diff(gaps[keep])) + 1)
