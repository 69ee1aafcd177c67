"""What no motion shows of an array, and how well it is known: its size and its frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.estimate.turns import Turns, common_scale
from imucalib.calibrators.array.log import ArrayLog
from imucalib.calibrators.array.moving import Moving
from imucalib.calibrators.array.rests import RestFit
from imucalib.rests.segments import Segments
from imucalib.units import DEG

#: Relative sd of gravity, by where its value comes from: anywhere on Earth (9.78 to 9.83 m/s²); of
#: a formula for the latitude (anomalies of some 50 mGal); as a user gives it, to a few digits.
_ANYWHERE, _BY_LATITUDE, _GIVEN = 1.3e-3, 5e-5, 1e-4
#: A package's turn on the board: sd, and how many degrees of freedom that belief is worth.
_MOUNTED, _BELIEF = 0.3 * DEG, 1.0


@dataclass(frozen=True)
class GyroScale:
    """The gyros' common scale, readings (1 + value) ω. tolerance : sd by the data sheets alone;
    turns : what the turns between rests say, or None"""

    value: float
    sd: float
    tolerance: float
    turns: Turns | None


def gyro_scale(tolerance: float, turns: Turns | None) -> GyroScale:
    """Data sheets and turns together."""
    if turns is None:
        return GyroScale(0.0, tolerance, tolerance, None)
    share = tolerance**2 / (tolerance**2 + turns.sd**2)
    return GyroScale(share * turns.scale, tolerance * float(np.sqrt(1.0 - share)), tolerance, turns)


def scale_by_turns(
    log: ArrayLog, segments: Segments, rests: RestFit, moving: Moving, order: list[int],
    *, gyro_gain: Array | None = None, factor: Array | None = None,
) -> GyroScale:  # fmt: skip
    """The common scale of the gyros, each corrected by its own gain beside the others.

    order : the board's IMUs in the segments' triads; gyro_gain : (K, 3, 3) of the joint fit, or
    None for the plain comparison of the gyros; factor : (K,) of each gyro's noise in motion
    """
    gain = moving.gyros.gain if gyro_gain is None else gyro_gain
    rate = common_rate(log.rate, gain, np.ones(len(gain)) if factor is None else factor)
    middle = 0.5 * (segments.start + segments.stop)
    still = np.einsum("kij,nkj->nki", rests.rotations, segments.mean[:, order])
    up = rests.corrected(still, middle).mean(axis=1)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    turns = common_scale(log.t, rate, ~log.clipped, up, segments.start, segments.stop)
    return gyro_scale(0.5 * moving.gyros.scale_sd, turns)


def common_rate(rate: Array, gain: Array, factor: Array) -> Array:
    """(n, 3) rad/s that corrected gyros (n, K, 3) say together, weighed as in the motion: the rate
    that the positions stand on. Where a bent response had passed for a gain, the plain mean of
    eight held an eighth of that, and the size a quarter; the motion's rate did not.

    gain : (K, 3, 3), reading = gain · rate; factor : (K,) of each gyro's noise
    """
    weight = factor**-2 / np.sum(factor**-2)
    back = weight[:, None, None] * np.linalg.inv(gain)
    return np.asarray(np.einsum("kij,nkj->ni", back, rate))


def gravity_sd(source: str) -> float:
    """Relative standard deviation of gravity by where its value comes from."""
    if source.startswith("standard"):
        return _ANYWHERE
    return _BY_LATITUDE if source.startswith("normal") else _GIVEN


def frame_sd(rests: RestFit) -> float:
    """rad about each axis, of the triads' mean axes against the board's: what the triads' own turns
    scatter, over the root of how many there are."""
    gain, _, _ = rests.in_board_axes()
    turn = 0.5 * (gain - gain.transpose(0, 2, 1))
    angles = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
    count = len(angles)
    square = float(np.sum((angles - angles.mean(axis=0)) ** 2)) + _BELIEF * _MOUNTED**2
    return float(np.sqrt(square / (3.0 * (count - 1) + _BELIEF) / count))
