"""The samples that the array's loop looks at: stretches of consecutive ones over the motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Index
from imucalib.calibrators.array.board import Board
from imucalib.calibrators.array.loop.motion import BoardMotion, board_motion
from imucalib.calibrators.array.moving import Moving
from imucalib.core.course import bends_of, slope_of
from imucalib.estimators.array.samples import Readings, Sampled, turning_slope

_STRETCH = 16  # consecutive samples, so that neighbours are there for derivatives
_BLOCK = 5.0  # s, parts of the motion that are held out together
FEWEST = 60
_READINGS, _LEAST, _MOST = 5000, 200, 625  # IMUs times samples that a search looks at
#: Sample intervals from one neighbour to the other below which they are neighbours.
_NEAR = 2.6


@dataclass(frozen=True)
class Setup:
    """What does not change in the search.

    readings : calibrated by the rests, at T samples and their neighbours; t : (T,) s
    inner : samples that have both neighbours; block : (inner,) of a few seconds, in order of time;
    first : (inner,) whether in the first held-out half: every other block
    apart : of the moving part, samples of which no clock may be learned: what was chosen to be
        looked at, also where only a part of it is
    order : (T,) 0..1 over the motion; board : with the drawing and its sd
    robust : whether tails and growth of the noise may be taken in
    rows : (T,) of the moving part; interval : s, of consecutive samples
    """

    readings: Readings
    t: Array
    order: Array
    inner: Index
    block: Index
    first: NDArray[np.bool_]
    apart: Index
    board: Board
    robust: bool
    rows: Index
    interval: float

    @property
    def triads(self) -> int:
        return self.board.count

    @property
    def imus(self) -> tuple[str, ...]:
        return self.board.imus


def array_setup(moving: Moving, board: Board, samples: int, *, robust: bool) -> Setup | None:
    """At most `samples` informative samples whose neighbours are informative too; None when
    there are too few."""
    near = with_neighbours(moving)
    if len(near) < FEWEST:
        return None
    return _setup(moving, board, stretches(near, samples), robust=robust, beside=True)


def every_sample(moving: Moving, setup: Setup, samples: int, *, beside: bool) -> Setup:
    """The same with all informative samples, at most `samples` of them.

    beside : whether only those whose neighbours are informative too
    """
    rows = with_neighbours(moving) if beside else moving.good
    return _setup(moving, setup.board, stretches(rows, samples), robust=setup.robust, beside=beside)


def _setup(moving: Moving, board: Board, chosen: Index, *, robust: bool, beside: bool) -> Setup:
    around = [chosen - 1, chosen, chosen + 1] if beside else [chosen]
    rows = np.unique(np.concatenate(around))
    inner = np.searchsorted(rows, chosen)
    t = moving.t[rows]
    span = float(max(np.ptp(t), 1e-9))
    block = ((t[inner] - t[0]) / min(_BLOCK, span / 8.0)).astype(np.intp)
    readings = Readings(moving.acceleration[rows], moving.rate[rows])
    return Setup(
        readings=readings,
        t=t,
        order=(t - t[0]) / span,
        inner=inner,
        block=block,
        first=block % 2 == 0,
        apart=rows[inner],
        board=board,
        robust=robust,
        rows=rows,
        interval=moving.interval,
    )


def part_of(setup: Setup, chosen: NDArray[np.bool_]) -> Setup:
    """Some of the samples (inner,) in whole blocks, with their neighbours; the halves of what is
    left are made of its own blocks, in turn."""
    middle, block = setup.inner[chosen], setup.block[chosen]
    rows = np.unique(np.concatenate([middle - 1, middle, middle + 1]))
    readings = Readings(setup.readings.acceleration[rows], setup.readings.rate[rows])
    turn = np.unique(block, return_inverse=True)[1]
    return replace(
        setup,
        readings=readings,
        t=setup.t[rows],
        order=setup.order[rows],
        inner=np.searchsorted(rows, middle),
        block=block,
        first=turn % 2 == 0,
        rows=setup.rows[rows],
    )


def looked_at(setup: Setup) -> Index:
    """Which of the samples (inner,) a search looks at. Many IMUs have many columns and many
    readings a sample: fewer samples say as much."""
    most = int(np.clip(_READINGS / setup.triads, _LEAST, _MOST))
    return np.linspace(0, len(setup.inner) - 1, min(most, len(setup.inner))).astype(np.intp)


def with_neighbours(moving: Moving) -> Index:
    """Informative samples whose two neighbours are informative and at the usual interval."""
    flag = np.zeros(len(moving.t) + 2, dtype=np.bool_)
    flag[1 + moving.good] = True
    steps = np.diff(moving.t)
    regular = np.concatenate([[False], np.abs(steps - moving.interval) < 0.3 * moving.interval])
    near = flag[1:-1] & flag[:-2] & flag[2:]
    near &= regular & np.concatenate([regular[1:], [False]])
    return np.flatnonzero(near)


def stretches(near: Index, samples: int) -> Index:
    """At most `samples` of the rows, in stretches of consecutive ones over all of them."""
    if len(near) <= samples:
        return near
    count = max(samples // _STRETCH, 8)
    size = samples // count
    starts = np.linspace(0, len(near) - size, count).astype(np.intp)
    return near[np.unique(starts[:, None] + np.arange(size))]


def motion_at(
    setup: Setup, sampled: Sampled, age: Array | None, *, courses: bool = False
) -> BoardMotion:
    """The fitted motion as effects take it; its jerk by the motion of the neighbours, zero where a
    sample has none. How the board turns is known with its derivative, the force amid the IMUs is
    not: only there are differences all that there is.

    courses : whether sensors may lag behind it
    """
    near = np.diff(setup.t) < 0.5 * _NEAR * setup.interval
    beside = np.column_stack([np.append(False, near), np.append(near, False)])
    bend, _ = bends_of(sampled.rate, sampled.spin, setup.t, beside)
    amid = np.mean(sampled.r, axis=0)
    common = slope_of(sampled.origin + sampled.turn @ amid, setup.t, beside)
    turning = (
        turning_slope(sampled.rate, sampled.spin, bend)
        * np.any(beside, axis=1, keepdims=True)[..., None]
    )
    jerk = common[:, None] + (sampled.r - amid) @ turning.transpose(0, 2, 1)
    found = board_motion(
        imus=setup.imus,
        rotations=setup.board.rotations,
        t=setup.t,
        order=setup.order,
        rate=sampled.rate,
        spin=sampled.spin,
        force=sampled.force,
        jerk=jerk,
        age=age,
    )
    return found.coursed(beside) if courses else found
