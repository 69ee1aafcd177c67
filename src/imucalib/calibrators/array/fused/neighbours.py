"""What the rates of the samples before and after say of dω/dt, and how far that can be believed.

Accelerometers show dω/dt of a sample by itself, with noise over the size of the board. Where the
motion is slow against the sampling, the difference of the neighbours' rates shows it far better;
where it is not, hardly at all. The third difference of the rates tells which: the error of a
central difference is its size over 6 Δt, to first order (Taylor).
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from imucalib.arrays import Array, Flags
from imucalib.estimators.array.fusion import FusedMotion

_LOST = 1.5  # median intervals between samples from which on they are no neighbours
_SLOW = 0.3  # share of the usual interval by which neighbours may be off
#: Samples over which the error of the difference is judged; and over which, where third differences
#: are hardly more than noise: what noise leaves of the squares of a few is not zero.
_FEW, _QUIET = 9, (27, 81)
#: Times what noise explains up to which that is so, and what a few squares then are at most: the
#: 98 % point of χ² with 3.9 degrees of freedom, those of nine whose correlations are (15/20)²,
#: (6/20)² and (1/20)².
_HARDLY, _MOST = 2.0, 2.9
_JUDGED = 25  # samples over which the accelerometers may contradict it
_ODD = 2.5  # times what noise explains, from which they do


def near_next(t: Array) -> Flags:
    """(T - 1,) whether a sample and the next are neighbours, none being lost between them."""
    step = np.diff(t)
    return np.asarray(step < _LOST * np.median(step))


def spin_by_neighbours(
    t: Array, motion: FusedMotion, late: Array | None
) -> tuple[Array, Array] | None:
    """dω/dt (T, 3) rad/s² by differences and its inverse variance, zero where neighbours are
    missing; None for too few samples.

    late : (T, K, 3, 3) s as in `fusion.Sensed`: the rate that gyros have is that of their mean time
    """
    if len(t) < _JUDGED:
        return None
    rate, variance, after = _as_read(motion, late)
    step = np.diff(t)
    usual = float(np.median(step))
    near = np.abs(step - usual) < _SLOW * usual
    spin, own = np.zeros_like(rate), np.full(rate.shape, np.inf)
    # What gyros read is of `after` seconds later: dω/dt at the stamp is so much of d²ω/dt² less.
    ahead = after[1:-1, None] / usual**2
    spin[1:-1] = (rate[2:] - rate[:-2]) / (2.0 * usual)
    spin[1:-1] -= ahead * (rate[2:] - 2.0 * rate[1:-1] + rate[:-2])
    around = variance[2:] + variance[:-2]
    own[1:-1] = around / (2.0 * usual) ** 2 + ahead**2 * (around + 4.0 * variance[1:-1])
    own[1:-1][~(near[1:] & near[:-1])] = np.inf
    error = _error(rate, variance, near, usual)
    # What the accelerometers see beside it, where that is more than noise: aliased motion.
    theirs = np.einsum("tii->ti", motion.covariance)[:, 3:6]
    known = np.isfinite(own)
    off = np.where(known, (spin - motion.spin) ** 2, 0.0)
    noise = np.where(known, theirs + own, 0.0) + error
    seen, due = _local(off, _JUDGED), _local(noise, _JUDGED)
    error += np.where(seen > _ODD * due, seen - due, 0.0)
    return spin, 1.0 / (own + error)


def _error(rate: Array, variance: Array, near: Flags, usual: float) -> Array:
    """(T, 3) (rad/s²)², the square of what a central difference of the rates is off by."""
    square, noise = np.zeros_like(rate), np.zeros_like(rate)
    whole = (near[2:] & near[1:-1] & near[:-2])[:, None]
    due = variance[3:] + 9.0 * (variance[2:-1] + variance[1:-2]) + variance[:-3]
    square[1:-2] = np.where(whole, np.diff(rate, n=3, axis=0) ** 2, 0.0)
    noise[1:-2] = np.where(whole, due, 0.0)
    few = _local(square, _FEW)
    error = few - _local(noise, _FEW)
    for window in _QUIET:
        many, due = _local(square, window), _local(noise, window)
        quiet = (many < _HARDLY * due) & (few < _MOST * due)
        error = np.where(quiet, many - due, error)
    return np.maximum(error, 0.0) / (6.0 * usual) ** 2


def _as_read(motion: FusedMotion, late: Array | None) -> tuple[Array, Array, Array]:
    """(T, 3) the rate at the gyros' mean time and its variance, in which the spin's noise is not;
    (T,) s by which that time is after the stamp."""
    variance = np.einsum("tii->ti", motion.covariance)
    if late is None:
        return motion.rate, variance[:, 6:], np.zeros(len(motion.rate))
    after = np.einsum("tkii->t", late) / (3.0 * late.shape[1])
    mean = after[:, None]
    cross = np.einsum("tii->ti", motion.covariance[:, 3:6, 6:])
    spread = variance[:, 6:] + 2.0 * mean * cross + mean**2 * variance[:, 3:6]
    return motion.rate + mean * motion.spin, np.maximum(spread, 0.0), after


def _local(values: Array, window: int) -> Array:
    return np.asarray(uniform_filter1d(values, window, axis=0, mode="nearest"))
