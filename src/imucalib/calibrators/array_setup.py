"""Which samples the array's loop looks at: stretches of consecutive ones, spread over the motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imucalib.calibrators.array_board import Board
from imucalib.calibrators.array_moving import Moving
from imucalib.calibrators.array_state import Setup
from imucalib.estimators.array_samples import Readings

Index = NDArray[np.intp]
_STRETCH = 16  # consecutive samples, so that neighbours are there for derivatives
_BLOCK = 5.0  # s, parts of the motion that are held out together
FEWEST = 60


def array_setup(moving: Moving, board: Board, samples: int, *, robust: bool) -> Setup | None:
    """At most `samples` informative samples whose neighbours are informative too; None when
    there are too few."""
    near = with_neighbours(moving)
    if len(near) < FEWEST:
        return None
    chosen = _stretches(near, samples)
    rows = np.unique(np.concatenate([chosen - 1, chosen, chosen + 1]))
    inner = np.searchsorted(rows, chosen)
    t = moving.t[rows]
    span = float(max(np.ptp(t), 1e-9))
    block = ((t[inner] - t[0]) / min(_BLOCK, span / 8.0)).astype(np.intp)
    readings = Readings(moving.acceleration[rows], moving.rate[rows])
    return Setup(
        readings, t, (t - t[0]) / span, inner, block % 2 == 0, board.imus, board.rotations,
        board.drawn, board.prior_sd, robust, rows,
    )  # fmt: skip


def with_neighbours(moving: Moving) -> Index:
    """Informative samples whose two neighbours are informative and at the usual interval."""
    flag = np.zeros(len(moving.t) + 2, dtype=np.bool_)
    flag[1 + moving.good] = True
    steps = np.diff(moving.t)
    regular = np.concatenate([[False], np.abs(steps - moving.interval) < 0.3 * moving.interval])
    near = flag[1:-1] & flag[:-2] & flag[2:]
    near &= regular & np.concatenate([regular[1:], [False]])
    return np.flatnonzero(near)


def _stretches(near: Index, samples: int) -> Index:
    if len(near) <= samples:
        return near
    count = max(samples // _STRETCH, 8)
    size = samples // count
    starts = np.linspace(0, len(near) - size, count).astype(np.intp)
    return near[np.unique(starts[:, None] + np.arange(size))]
