"""Where the fit of a sample begins, and what it makes of gyros at the end of their range."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.calibrators.array.fused.instrument import Instrument
from imucalib.calibrators.array.fused.stretch import Stretch, along
from imucalib.calibrators.array.moving import SLOWEST
from imucalib.estimators.array.fusion import FusedMotion, Sensed, fused_motion

_BEYOND = 1.15  # times its range that a clipped rate is first thought to be
_FARTHER = (1.4, 2.0)  # times the first guess, where that led to an answer inside the range
_FAINT = 1e-6  # weight of that guess
_GONE = 0.5  # share of one gyro's say along an axis below which gyros do not see it


@dataclass(frozen=True)
class Start:
    """force, gyro : (T, K, 3) corrected by the linear parts, board axes
    live, rate_live : (T, K, 3) axes that are there and in range
    first : (T, 3) rad/s; alone : (T,) no gyro sees some part of the rate
    """

    force: Array
    gyro: Array
    live: Flags
    rate_live: Flags
    first: Array
    alone: Flags


def start_of(instrument: Instrument, stretch: Stretch) -> Start:
    """Corrected readings, and the rates that the gyros say: the median of whole triads; a little
    beyond the range where all gyros are at its end."""
    force, gyro = instrument.corrected(stretch.t, stretch.acceleration, stretch.rate)
    clipped, rate_clipped = instrument.clipped(stretch.acceleration, stretch.rate)
    live = np.isfinite(stretch.acceleration) & ~clipped
    there = np.isfinite(stretch.rate)
    rate_live = there & ~rate_clipped
    whole = np.all(rate_live, axis=2)
    some = np.any(whole, axis=1)
    first = np.zeros((len(stretch.t), 3))
    inner = np.where(whole[some][..., None], gyro[some], np.nan)
    first[some] = np.nanmedian(inner, axis=1)
    alone = np.zeros(len(stretch.t), dtype=np.bool_)
    if not np.all(some):
        rest = ~some
        part = (gyro[rest], rate_live[rest], (there & rate_clipped)[rest])
        first[rest], alone[rest] = _guessed(instrument.gyro_axes, *part)
    return Start(force, gyro, live, rate_live, first, alone)


def turning(instrument: Instrument, stretch: Stretch) -> Flags:
    """(T,) samples that rotate, by their gyros."""
    return np.asarray(np.linalg.norm(start_of(instrument, stretch).first, axis=1) > SLOWEST)


def _guessed(axes: Array, gyro: Array, live: Flags, clipped: Flags) -> tuple[Array, Flags]:
    """Rates (n, 3) of samples without a whole gyro, and where nothing in range sees a part."""
    squares = (axes[:, :, :, None] * axes[:, :, None, :]).reshape(-1, 9)
    reading = np.where(clipped, _BEYOND, 1.0) * along(axes, gyro)
    weight = live + _FAINT * clipped
    matrix = (weight.reshape(len(gyro), -1) @ squares).reshape(-1, 3, 3)
    right = (weight * reading).reshape(len(gyro), -1) @ axes.reshape(-1, 3)
    first = np.linalg.solve(matrix + _FAINT**2 * np.eye(3), right[..., None])[..., 0]
    seen = (live.reshape(len(gyro), -1).astype(float) @ squares).reshape(-1, 3, 3)
    return np.asarray(first, np.float64), np.asarray(np.linalg.eigvalsh(seen)[:, 0] < _GONE)


def outside(
    instrument: Instrument, stretch: Stretch, start: Start, sensed: Sensed, motion: FusedMotion
) -> FusedMotion:
    """The motion with answers that lie inside the range, or have the wrong sign, sought again from
    farther out: the rate hangs on its square there, and has more than one answer."""
    for times in _FARTHER:
        rows = np.flatnonzero(np.any(inside(instrument, stretch, start, motion), axis=(1, 2)))
        if not len(rows):
            break
        again = fused_motion(sensed.take(rows), instrument.r, times * start.first[rows])
        motion = motion.put(rows, again)
    return motion


def inside(instrument: Instrument, stretch: Stretch, start: Start, motion: FusedMotion) -> Flags:
    """(T, K, 3) clipped axes of samples that no gyro sees whole, whose fused rate lies inside the
    range: there the reading itself, the end of the range, is nearer."""
    lost = np.isfinite(stretch.rate) & ~start.rate_live & start.alone[:, None, None]
    if not lost.any():
        return lost
    axes = instrument.gyro_axes
    own = along(axes, np.broadcast_to(motion.rate[:, None], start.gyro.shape))
    read = along(axes, start.gyro)
    return np.asarray(lost & (own * np.sign(read) < np.abs(read)))
