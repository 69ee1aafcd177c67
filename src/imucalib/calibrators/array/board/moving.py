"""Which moving samples say something about the positions.

At rest a gyro shows its offset only. In motion the triads are compared with each other: gain G_k
of each relative to the mean rate, whose own gain is one by definition. The common gyro scale trades
off against the array's size (size changes by minus twice the scale): it is held by the mean of the
gyros and reported, never fitted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.calibrators.array.board.log import ArrayLog
from imucalib.calibrators.array.board.rests import RestFit
from imucalib.errors import Undetermined
from imucalib.units import DEG

SLOWEST = 60.0 * DEG  # rad/s below which a sample counts as not rotating
WIDEST = 0.05  # gyro scatter over |ω| above which the rate is not known well enough
FEWEST = 30
SCALE_TOLERANCE = 0.03  # of one gyro's scale, by the data sheets of consumer parts
_ODD = 1.5  # factor between one gyro and the others that no tolerance explains


@dataclass(frozen=True)
class Gyros:
    """gain : (K, 3, 3), reading = G_k ω; mean : (N, 3) rad/s of the corrected triads;
    scatter : (N,) rad/s, rms over the triads and axes; covariance : (3, 3) of one triad."""

    gain: Array
    mean: Array
    scatter: Array
    covariance: Array

    @property
    def triads(self) -> int:
        return len(self.gain)


def relative_gyros(rate: Array, rows: Index) -> Gyros:
    """Fit the gains on samples `rows` of rates (N, K, 3) rad/s and apply them to all."""
    triads = rate.shape[1]
    gain = np.broadcast_to(np.eye(3), (triads, 3, 3)).copy()
    chosen = rate[rows]
    for _ in range(20):
        corrected = np.einsum("kij,nkj->nki", np.linalg.inv(gain), chosen)
        w = corrected.mean(axis=1)
        normal = w.T @ w
        fitted = np.stack([np.linalg.solve(normal, w.T @ chosen[:, k]).T for k in range(triads)])
        fitted = fitted @ np.linalg.inv(fitted.mean(axis=0))
        moved = np.abs(fitted - gain).max()
        gain = fitted
        if moved < 1e-12:
            break
    corrected = np.einsum("kij,nkj->nki", np.linalg.inv(gain), rate)
    mean = corrected.mean(axis=1)
    off = corrected - mean[:, None]
    freedom = (triads - 1) / triads
    scatter = np.sqrt(np.mean(off**2, axis=(1, 2)) / freedom)
    apart = off[rows].reshape(-1, 3)
    # Robust: half the samples near the median carry the spread, a few far ones do not.
    width = np.median(np.abs(apart), axis=0) / 0.6745
    inside = np.all(np.abs(apart) < 4.0 * width, axis=1)
    covariance = apart[inside].T @ apart[inside] / inside.sum() / freedom
    return Gyros(gain, mean, scatter, covariance)


@dataclass(frozen=True)
class Moving:
    """The moving part, calibrated by gravity and by the gyros' mean: N samples that turn, and those
    beside them.

    t : (N,) s; acceleration : (N, K, 3); rate : (N, K, 3) rad/s as each gyro reads it, without
    offset; gyros : their comparison; good : indices of the informative samples; counts : samples
    by what became of them
    """

    t: Array
    acceleration: Array
    rate: Array
    gyros: Gyros
    good: Index
    interval: float
    counts: dict[str, int]

    @cached_property
    def amid(self) -> Index:
        """Informative samples whose two neighbours are informative and at the usual interval."""
        good = np.zeros(len(self.t) + 2, dtype=np.bool_)
        good[1 + self.good] = True
        regular = np.abs(np.diff(self.t) - self.interval) < 0.3 * self.interval
        amid = good[1:-1] & good[:-2] & good[2:]
        return np.flatnonzero(amid & np.append(False, regular) & np.append(regular, False))

    @property
    def levelled(self) -> Moving:
        """With every gyro in the scale and the axes of their mean, as plain comparison has them."""
        inverse = np.linalg.inv(self.gyros.gain)
        return replace(self, rate=np.einsum("kij,nkj->nki", inverse, self.rate))


def find_moving(log: ArrayLog, rests: RestFit) -> Moving:
    """Correct, and find the informative samples. Raises Undetermined when there are too few or a
    gyro is in another unit than the others."""
    t, force, rate, clipped = _around_motion(log, rests)
    speed = np.linalg.norm(np.median(rate, axis=1), axis=1)
    turning = speed > SLOWEST
    if turning.any():
        _refuse_odd(np.linalg.norm(rate[turning], axis=2) / speed[turning, None], rests.imus)
    usable = turning & ~clipped
    counts = {"rotating": int(turning.sum()), "clipped": int((turning & clipped).sum())}
    _refuse_few(counts, int(usable.sum()))
    gyros = relative_gyros(rate, np.flatnonzero(usable))
    wide = usable & (gyros.scatter > WIDEST * np.linalg.norm(gyros.mean, axis=1))
    good = np.flatnonzero(usable & ~wide)
    counts |= {"gyros scattered": int(wide.sum()), "informative": len(good)}
    _refuse_few(counts, len(good))
    return Moving(
        t=t,
        acceleration=rests.correct(force, t),
        rate=rate,
        gyros=gyros,
        good=good,
        interval=log.interval,
        counts=counts,
    )


def _around_motion(log: ArrayLog, rests: RestFit) -> tuple[Array, Array, Array, Flags]:
    """Times, raw forces, rates without offsets and clipping of the samples that turn and those
    beside them: a log is mostly rest, and large."""
    offset = rests.subtract_bias(np.zeros((1, *log.rate.shape[1:])), log.t[-1:])[0]
    turning = np.linalg.norm(np.median(log.rate + offset, axis=1), axis=1) > 0.5 * SLOWEST
    turning[1:-1] |= turning[2:] | turning[:-2]
    if not turning.any():
        turning[:1] = True
    t = log.t[turning]
    rate = rests.subtract_bias(log.rate[turning], t)
    return t, log.acceleration[turning], rate, log.clipped[turning]


def _refuse_odd(ratio: Array, imus: tuple[str, ...]) -> None:
    """ratio : (n, K) each gyro's |ω| over that of their median."""
    typical = np.median(ratio, axis=0)
    worst = int(np.argmax(np.abs(np.log(np.maximum(typical, 1e-9)))))
    if not 1.0 / _ODD < typical[worst] < _ODD:
        raise Undetermined(
            f"the gyro of {imus[worst]} reads {typical[worst]:.2g} times what the others read",
            remedy="check its unit (deg/s against rad/s: 57.3) and scale in the recording or its "
            "mapping, or take the IMU off the board file",
        )


def _refuse_few(counts: dict[str, int], left: int) -> None:
    if left < FEWEST:
        words = ", ".join(f"{n} {name}" for name, n in counts.items())
        raise Undetermined(
            f"too little rotation: {left} informative samples ({words})",
            remedy=f"twist the array about all axes, faster than {SLOWEST / DEG:.0f} deg/s and "
            "within the gyros' range, for half a minute; check the gyros' unit",
        )
