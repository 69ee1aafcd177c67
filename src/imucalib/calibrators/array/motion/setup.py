"""The samples that the array's loop looks at: stretches of consecutive ones over the motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.calibrators.array.board.board import Board
from imucalib.calibrators.array.board.moving import Moving
from imucalib.estimators.array.samples import Pair, find_sides

_STRETCH = 16  # consecutive samples, so that neighbours are there for derivatives
_NEXT = 1.3  # sample intervals from one to the next below which they are neighbours
_BLOCK = 5.0  # s, parts of the motion that are held out together
FEWEST = 60
_READINGS, _LEAST, _MOST = 5000, 200, 625  # IMUs times samples that a search looks at


@dataclass(frozen=True)
class Setup:
    """T samples of a motion and their neighbours, which a search does not change.

    board : with the drawing and its sd
    rows : (T,) of the moving part; inner : those of them with both neighbours, which are fitted to
    block : (inner,) of a few seconds, in order of time; first : (inner,) whether in the first
        held-out half: every other block
    chosen : rows of the moving part of which no clock may be learned: what a search looks at, also
        where this is only a part of it
    start, span : s, the first time of the motion and its length
    """

    moving: Moving
    board: Board
    rows: Index
    inner: Index
    block: Index
    first: Flags
    chosen: Index
    start: float
    span: float

    @cached_property
    def readings(self) -> Pair:
        """Calibrated by the rests."""
        return Pair(self.moving.acceleration[self.rows], self.moving.rate[self.rows])

    @cached_property
    def t(self) -> Array:
        """(T,) s."""
        return self.moving.t[self.rows]

    @cached_property
    def sides(self) -> Flags:
        """(T, 2) whether the sample before and the one after are neighbours."""
        return find_sides(self.t, _NEXT * self.moving.interval)

    @property
    def order(self) -> Array:
        """(T,) 0..1 over the motion."""
        return (self.t - self.start) / self.span


def array_setup(moving: Moving, board: Board, samples: int) -> Setup | None:
    """At most `samples` informative samples whose neighbours are informative too; None when
    there are too few."""
    if len(moving.amid) < FEWEST:
        return None
    return set_up(moving, board, samples, neighbours=True)


def set_up(moving: Moving, board: Board, samples: int, *, neighbours: bool) -> Setup:
    """At most `samples` informative samples, however few there are.

    neighbours : whether only those whose neighbours are informative too
    """
    chosen = _stretches(moving.amid if neighbours else moving.good, samples)
    rows = _around(chosen) if neighbours else chosen
    t = moving.t[rows]
    span = float(max(np.ptp(t), 1e-9))
    block = ((moving.t[chosen] - t[0]) / min(_BLOCK, span / 8.0)).astype(np.intp)
    return Setup(
        moving=moving,
        board=board,
        rows=rows,
        inner=np.searchsorted(rows, chosen),
        block=block,
        first=block % 2 == 0,
        chosen=chosen,
        start=float(t[0]),
        span=span,
    )


def part_of(setup: Setup, some: Flags) -> Setup:
    """Some of the samples (inner,) in whole blocks, with their neighbours; the halves of what
    remains are made of its own blocks, in turn."""
    middle, block = setup.rows[setup.inner[some]], setup.block[some]
    rows = _around(middle)
    turn = np.unique(block, return_inverse=True)[1]
    inner = np.searchsorted(rows, middle)
    return replace(setup, rows=rows, inner=inner, block=block, first=turn % 2 == 0)


def _around(rows: Index) -> Index:
    """Samples and their neighbours, each once."""
    return np.unique(np.concatenate([rows - 1, rows, rows + 1]))


def select_searched(setup: Setup) -> Index:
    """Which of the samples (inner,) a search looks at. Many IMUs have many columns and many
    readings a sample: fewer samples say as much."""
    most = int(np.clip(_READINGS / setup.board.count, _LEAST, _MOST))
    return np.linspace(0, len(setup.inner) - 1, min(most, len(setup.inner))).astype(np.intp)


def _stretches(rows: Index, samples: int) -> Index:
    """At most `samples` of the rows, in stretches of consecutive ones over all of them."""
    if len(rows) <= samples:
        return rows
    count = max(samples // _STRETCH, 8)
    size = samples // count
    starts = np.linspace(0, len(rows) - size, count).astype(np.intp)
    return rows[np.unique(starts[:, None] + np.arange(size))]
