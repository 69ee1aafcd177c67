"""All columns of a search, white for every noise that is tried, and their sums over parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Index
from imucalib.loop.design import Fold
from imucalib.loop.wander.walk import Course, Walk, whitened

Mask = NDArray[np.bool_]

#: Bounds of the walk's memory: 3 min, and a sixth of the recording, beyond which it is a drift.
_SHORTEST, _LONGEST = 180.0, 1.0 / 6.0
_TAU_RATIO, _TAUS = 4.0, 4
_RHO = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)


def walks_of(time: Array) -> tuple[Walk, ...]:
    """The noise that is tried; the first is white."""
    longest = float(np.ptp(time)) * _LONGEST
    taus = [longest / _TAU_RATIO**k for k in range(_TAUS)]
    pairs = [Walk(rho, tau) for tau in taus if tau > _SHORTEST for rho in _RHO]
    return (Walk(0.0, 1.0), *pairs)


def parts_of(folds: Sequence[Fold], n: int) -> Index:
    """(n,) parts: neighbours that every fold treats alike, so that folds are sums of parts."""
    treated = np.zeros((n, len(folds)), dtype=np.int8)
    for k, fold in enumerate(folds):
        treated[:, k] = 1
        treated[fold.rest, k] = 0
        treated[fold.rows, k] = 2
    new = np.any(treated[1:] != treated[:-1], axis=1)
    return np.concatenate([[0], np.cumsum(new)]).astype(np.intp)


@dataclass(frozen=True)
class Split:
    """One fold in parts (masks): test : that are predicted; train : that choose and fit."""

    test: Mask
    train: Mask


def splits_of(folds: Sequence[Fold], part: Index) -> tuple[Split, ...]:
    def mask(rows: Index) -> Mask:
        out = np.zeros(int(part[-1]) + 1, dtype=bool)
        out[part[rows]] = True
        return out

    return tuple(Split(mask(f.rows), mask(f.rest)) for f in folds)


@dataclass(frozen=True)
class Bank:
    """columns : (n, m) base, candidates and the data y, in units of the scatter of a run; data :
    which of them is y; white : (walks, n, m); log_det : (walks, parts)"""

    course: Course
    walks: tuple[Walk, ...]
    columns: Array
    data: int
    white: Array
    log_det: Array
    _sums: dict[tuple[int, bytes], Array] = field(default_factory=dict, repr=False)
    _whole: dict[int, Array] = field(default_factory=dict, repr=False)
    _added: dict[bytes, Array] = field(default_factory=dict, repr=False)
    #: What scores keep of the whole data between searches with and without simulated data.
    made: dict[tuple[int, bytes, bytes], object] = field(default_factory=dict, repr=False)

    @property
    def count(self) -> Index:
        """(parts,) rows of each part."""
        return np.bincount(self.course.part).astype(np.intp)

    def train(self, walk: int, keep: Mask) -> Array:
        """(m, m) products of all columns over the parts that are kept."""
        white = self.white[walk]
        if walk not in self._whole:
            self._whole[walk] = white.T @ white
        if keep.all():
            return self._whole[walk]
        out = white[~keep[self.course.part]]
        return np.asarray(self._whole[walk] - out.T @ out)

    def products(self, columns: Index, keep: Mask) -> Array:
        """(walks, c, c) products of some columns over the parts that are kept."""
        if keep.all():
            picked = self.white[:, :, columns]
            return np.asarray(picked.transpose(0, 2, 1) @ picked)
        every = range(len(self.walks))
        return np.stack([self.by_part(walk, columns)[keep].sum(axis=0) for walk in every])

    def by_part(self, walk: int, columns: Index) -> Array:
        """(parts, c, c) products of some columns, part by part."""
        key = (walk, columns.tobytes())
        if key not in self._sums:
            picked = self.white[walk][:, columns]
            edges = np.searchsorted(self.course.part, np.arange(self.course.parts + 1))
            self._sums[key] = np.stack([picked[a:b].T @ picked[a:b] for a, b in pairwise(edges)])
        return self._sums[key]

    def plus(self, columns: Array) -> Bank:
        """With more columns (n, c) behind all others."""
        key = columns.tobytes()
        if key not in self._added:  # searches without one block after the other end at the same
            self._added[key] = whitened(self.course, self.walks, columns)[0]
        white = self._added[key]
        both = np.concatenate([self.white, white], axis=2)
        every = np.column_stack([self.columns, columns])
        return replace(self, columns=every, white=both, _whole={}, made={})


def bank_of(course: Course, walks: tuple[Walk, ...], columns: Array) -> Bank:
    """The last of the columns is the data."""
    white, log_det = whitened(course, walks, columns)
    return Bank(course, walks, columns, columns.shape[1] - 1, white, log_det)
