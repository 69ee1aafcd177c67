"""The gyros' common scale from the turns between rests: gravity is seen before and after.

Motion alone cannot show it: readings (1 + k) ω give positions 1 / (1 + k)² as large. Between two
rests gravity turns in the board's axes by what the gyros integrate to, du/dt = -ω x u, and by no
other scale.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.calibrators.array.board.log import ArrayLog
from imucalib.calibrators.array.board.moving import SCALE_TOLERANCE
from imucalib.calibrators.array.board.rests import RestFit
from imucalib.rests.segments import Segments

_FEWEST = 5  # turns from which on their scatter says how good they are
_LEAST = np.radians(10.0)  # of gravity, below which a turn says nothing
_FINER = 4  # times that the rate is interpolated between its samples
_GAP = 1.5  # sample intervals from which on some are missing
_STEP = 1e-3  # relative, of the derivative by the scale
_HEAVY = 4.0  # degrees of freedom of the turns' errors


@dataclass(frozen=True)
class BoardTurns:
    """scale, sd : relative error k of the gyros' common scale, reading = (1 + k) ω; count : of the
    turns; misfit : rad, rms of what a turn misses"""

    scale: float
    sd: float
    count: int
    misfit: float


@dataclass(frozen=True)
class GyroScale:
    """The gyros' common scale, readings (1 + value) ω. tolerance : sd by the data sheets alone;
    turns : what the turns between rests say, or None"""

    value: float
    sd: float
    tolerance: float
    turns: BoardTurns | None


def gyro_scale(tolerance: float, turns: BoardTurns | None) -> GyroScale:
    """Data sheets and turns together."""
    if turns is None:
        return GyroScale(0.0, tolerance, tolerance, None)
    share = tolerance**2 / (tolerance**2 + turns.sd**2)
    return GyroScale(share * turns.scale, tolerance * float(np.sqrt(1.0 - share)), tolerance, turns)


def scale_by_turns(
    log: ArrayLog, segments: Segments, rests: RestFit, gain: Array, factor: Array
) -> GyroScale:
    """The common scale of the gyros, each corrected by its own gain.

    Their rate is weighed as in the motion, which the positions stand on: where a bent response had
    passed for a gain, the plain mean of eight held an eighth of that, and the size a quarter; the
    motion's rate did not. Data sheets leave the mean of all axes uniform within each one's
    tolerance.

    gain : (K, 3, 3), reading = gain · rate; factor : (K,) of each gyro's noise in motion
    """
    weight = factor**-2 / np.sum(factor**-2)
    rate = np.einsum("kij,nkj->ni", weight[:, None, None] * np.linalg.inv(gain), log.rate)
    middle = 0.5 * (segments.start + segments.stop)
    still = np.einsum("kij,nkj->nki", rests.rotations, segments.mean)
    up = rests.correct(still, middle).mean(axis=1)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    turns = common_scale(log.t, rate, ~log.clipped, up, segments.start, segments.stop)
    return gyro_scale(SCALE_TOLERANCE / float(np.sqrt(9.0 * len(gain))), turns)


def common_scale(
    t: Array, rate: Array, usable: Flags, up: Array, start: Array, stop: Array
) -> BoardTurns | None:
    """The scale by all turns between consecutive rests; None where there are too few.

    t : (n,) s; rate : (n, 3) rad/s, mean of the gyros in board axes, their offsets in it; usable :
    (n,) not clipped; up : (m, 3) unit vectors of gravity at m rests from start to stop (m,) s
    """
    within = [(t >= a) & (t <= b) for a, b in zip(start, stop, strict=True)]
    offset = [rate[at].mean(axis=0) if at.any() else np.full(3, np.nan) for at in within]
    middle = 0.5 * (start + stop)
    off, slope = [], []
    for k, rows in enumerate(between(t, start, stop, _GAP)):
        if rows.size <= 3 or not usable[rows].all() or up[k] @ up[k + 1] > np.cos(_LEAST):
            continue
        share = ((t[rows] - middle[k]) / (middle[k + 1] - middle[k]))[:, None]
        own = rate[rows] - (1.0 - share) * offset[k] - share * offset[k + 1]
        if not np.isfinite(own).all():
            continue
        one, less, more = (_carry(t[rows], own / (1.0 + h), up[k]) for h in (0.0, -_STEP, _STEP))
        off.append(up[k + 1] - one)
        slope.append((more - less) / (2.0 * _STEP))
    if len(off) < _FEWEST:
        return None
    return _fit(np.array(off), np.array(slope))


def between(t: Array, start: Array, stop: Array, gap: float) -> list[Index]:
    """Samples of times t (n,) s from inside each rest to inside the next; none where some are
    missing between them for more than `gap` intervals."""
    step = float(np.median(np.diff(t)))
    ends = np.searchsorted(t, stop[:-1]), np.searchsorted(t, start[1:], side="right")
    spans = [np.arange(max(a - 1, 0), b) for a, b in zip(*ends, strict=True)]
    return [s if np.diff(t[s]).max(initial=0.0) < gap * step else s[:0] for s in spans]


def compose_rotations(turns: Array) -> Array:
    """(..., 3, 3) of rotations (..., n, 3, 3), the first one first: multiplied in pairs."""
    while turns.shape[-3] > 1:
        if turns.shape[-3] % 2:
            same = np.broadcast_to(np.eye(3), (*turns.shape[:-3], 1, 3, 3))
            turns = np.concatenate([turns, same], axis=-3)
        turns = turns[..., 1::2, :, :] @ turns[..., ::2, :, :]
    return turns[..., 0, :, :]


def _carry(t: Array, rate: Array, vector: Array) -> Array:
    """(3,) what a vector that stands still in space becomes in axes that turn."""
    from scipy.interpolate import CubicSpline
    from scipy.spatial.transform import Rotation

    edges = np.interp(np.arange(_FINER * (len(t) - 1) + 1) / _FINER, np.arange(len(t)), t)
    small = CubicSpline(t, rate)(0.5 * (edges[1:] + edges[:-1])) * np.diff(edges)[:, None]
    return np.asarray(compose_rotations(Rotation.from_rotvec(-small).as_matrix()) @ vector)


def _fit(off: Array, slope: Array) -> BoardTurns:
    scale = _robust(off, slope)
    n = len(off)
    each = np.arange(n)
    without = np.array([_robust(off[each != k], slope[each != k]) for k in range(n)])
    # The jackknife of n turns; its own doubt as in Student's distribution.
    variance = (n - 1) / n * float(np.sum((without - without.mean()) ** 2)) * (n - 1) / (n - 3)
    misfit = np.sqrt(np.mean(np.sum((off - scale * slope) ** 2, axis=1)))
    return BoardTurns(scale, float(np.sqrt(variance)), n, float(misfit))


def _robust(off: Array, slope: Array) -> float:
    """Scale with errors of Student's t: weights and their size in turn."""
    scale, weight = 0.0, np.ones(len(off))
    for _ in range(30):
        power = weight @ np.sum(slope * slope, axis=1)
        scale = float(weight @ np.sum(slope * off, axis=1) / max(power, 1e-300))
        square = np.sum((off - scale * slope) ** 2, axis=1) / 2.0
        size = max(float(np.sum(weight * square) / np.sum(weight)), 1e-300)
        weight = (_HEAVY + 2.0) / (_HEAVY + 2.0 * square / size)
    return scale
