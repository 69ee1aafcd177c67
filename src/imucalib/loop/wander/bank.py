"""All columns of a search, white for every noise that is tried, and their sums over parts."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Index
from imucalib.loop.design import Fold
from imucalib.loop.wander.walk import Course, Walk, among, log_det, whitened

Mask = NDArray[np.bool_]

#: Bounds of the walk's memory: 3 min, and a sixth of the recording, beyond which it is a drift.
_SHORTEST, _LONGEST = 180.0, 1.0 / 6.0
_TAU_RATIO, _TAUS = 4.0, 4
_RHO = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
#: Walks whose white columns are held at once.
_AT_ONCE = 4


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
    which of them is y; log_det : (walks, parts). White columns are made when they are asked for:
    all of them would be the largest thing in memory, and only their products are read often."""

    course: Course
    walks: tuple[Walk, ...]
    columns: Array
    data: int
    log_det: Array
    _whole: dict[int, Array] = field(default_factory=dict, repr=False)
    _rows: dict[int, Array] = field(default_factory=dict, repr=False)
    _sums: dict[tuple[int, bytes], Array] = field(default_factory=dict, repr=False)
    _kept: dict[tuple[bytes, bytes], Array] = field(default_factory=dict, repr=False)
    _out: dict[bytes, Bank] = field(default_factory=dict, repr=False)
    _added: dict[bytes, Bank] = field(default_factory=dict, repr=False)
    #: The bank that lacks the last of the columns.
    _fewer: Bank | None = field(default=None, repr=False)
    #: What scores keep of the whole data between searches with and without simulated data.
    made: dict[tuple[int, bytes, bytes], object] = field(default_factory=dict, repr=False)

    @property
    def count(self) -> Index:
        """(parts,) rows of each part."""
        return np.bincount(self.course.part).astype(np.intp)

    def white(self, walk: int, columns: Index) -> Array:
        """(n, c) some of the columns under one walk."""
        if walk in self._rows:
            return np.asarray(self._rows[walk][:, columns])
        alone = slice(walk, walk + 1)
        white = whitened(self.course, self.walks, self.columns[:, columns], alone)[0]
        return np.asarray(white[0])

    def over(self, walk: int, keep: Mask) -> tuple[Array, Array]:
        """(m, m) products of all columns over all rows, and their white rows (r, m) of the parts
        that are not kept."""
        if keep.all():
            return self._gram(walk), np.empty((0, self.columns.shape[1]))
        out = self._without(keep)
        if walk not in out._rows:
            few = slice(walk, walk + _AT_ONCE)
            white = whitened(out.course, self.walks, out.columns, few)[0]
            out._rows.update(enumerate(white, walk))
        return self._gram(walk), out._rows[walk]

    def products(self, columns: Index, keep: Mask) -> Array:
        """(walks, c, c) products of some columns over the parts that are kept."""
        key = columns.tobytes(), keep.tobytes()
        if key not in self._kept:
            if keep.all():
                self._kept[key] = self._products(columns)
            else:
                whole = self.products(columns, np.ones_like(keep))
                self._kept[key] = whole - self._without(keep)._products(columns)
        return self._kept[key]

    def by_part(self, walk: int, columns: Index) -> Array:
        """(parts, c, c) products of some columns, part by part."""
        key = (walk, columns.tobytes())
        if key not in self._sums:
            picked = self._every_row(walk)[:, columns]
            edges = np.searchsorted(self.course.part, np.arange(self.course.parts + 1))
            self._sums[key] = np.stack([picked[a:b].T @ picked[a:b] for a, b in pairwise(edges)])
        return self._sums[key]

    def plus(self, columns: Array) -> Bank:
        """With more columns (n, c) behind all others."""
        key = columns.tobytes()
        if key not in self._added:  # searches without one block after the other end at the same
            every = np.column_stack([self.columns, columns])
            added = Bank(self.course, self.walks, every, self.data, self.log_det, _fewer=self)
            # Products of columns that stay where they are.
            added._kept.update(self._kept)
            added._sums.update(self._sums)
            self._added[key] = added
        return self._added[key]

    def only(self, columns: Index) -> Bank:
        """Some of the columns, the data last of them, with the products that were made of them."""
        picked = self.columns[:, columns]
        out = Bank(self.course, self.walks, picked, columns.size - 1, self.log_det)
        place = np.full(self.columns.shape[1], -1, np.intp)
        place[columns] = np.arange(columns.size)

        def moved(key: bytes) -> bytes:
            now = place[np.frombuffer(key, np.intp)]
            return b"" if np.any(now < 0) else now.tobytes()

        for (key, keep), products in self._kept.items():
            if now := moved(key):
                out._kept[now, keep] = products
        for (walk, key), sums in self._sums.items():
            if now := moved(key):
                out._sums[walk, now] = sums
        return out

    def under(self, walks: Collection[Walk]) -> Bank:
        """With no other walks than these and the first; what was made for them is kept."""
        some = [k for k, walk in enumerate(self.walks) if not k or walk in walks]
        own = among(self.course, self.walks, some)
        out = Bank(self.course, own, self.columns, self.data, self.log_det[some])
        for now, k in enumerate(some):
            for had, has in ((self._whole, out._whole), (self._rows, out._rows)):
                if k in had:
                    has[now] = had[k]
        return out

    def _every_row(self, walk: int) -> Array:
        """(n, m) all columns under one walk: blocks are predicted by one model after the other."""
        if walk not in self._rows:
            had = None if self._fewer is None else self._fewer._rows.get(walk)
            start = 0 if had is None else had.shape[1]
            new = self.white(walk, np.arange(start, self.columns.shape[1]))
            self._rows[walk] = new if had is None else np.column_stack([had, new])
        return self._rows[walk]

    def _gram(self, walk: int) -> Array:
        """(m, m) of all rows; made for a few walks at once."""
        if walk not in self._whole:
            few = slice(walk, walk + _AT_ONCE)
            white = whitened(self.course, self.walks, self.columns, few)[0]
            self._whole.update((k, own.T @ own) for k, own in enumerate(white, walk))
        return self._whole[walk]

    def _products(self, columns: Index) -> Array:
        every = range(len(self.walks))
        if all(k in self._whole for k in every):
            return np.stack([self._whole[k][columns[:, None], columns] for k in every])
        white = whitened(self.course, self.walks, self.columns[:, columns])[0]
        return np.asarray(white.transpose(0, 2, 1) @ white)

    def _without(self, keep: Mask) -> Bank:
        """The rows of the parts that are not kept; of the last such mask."""
        key = keep.tobytes()
        if key not in self._out:
            self._out.clear()
            course = self.course
            rows = ~keep[course.part]
            own = Course(
                course.time[rows], course.seen[rows], course.variance[rows],
                np.unique(course.part[rows], return_inverse=True)[1].astype(np.intp),
            )  # fmt: skip
            self._out[key] = Bank(
                own, self.walks, self.columns[rows], self.data, self.log_det[:, ~keep]
            )
        return self._out[key]


def bank_of(course: Course, walks: tuple[Walk, ...], columns: Array) -> Bank:
    """The last of the columns is the data."""
    return Bank(course, walks, columns, columns.shape[1] - 1, log_det(course, walks))
