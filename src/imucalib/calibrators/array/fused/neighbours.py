"""What the rates of the samples before and after say of dω/dt, and how far that can be believed.

Accelerometers show dω/dt of a sample by itself, with noise over the size of the board. Where the
motion is slow against the sampling, the difference of the neighbours' rates shows it far better;
where it is not, hardly at all. The third difference of the rates tells which: the error of a
central difference is its size over 6 Δt, to first order (Taylor).
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from imucalib.arrays import Array
from imucalib.estimators.array.fusion import FusedMotion

_SLOW = 0.3  # share of the usual interval by which neighbours may be off
_WINDOW = 9  # samples over which the error of the difference is judged
_DOUBT = 2.0  # times the third difference's own estimate, since that is of first order
_ODD = 2.0  # times what noise explains, from which the accelerometers contradict


def spin_by_neighbours(
    t: Array, motion: FusedMotion, late: Array | None
) -> tuple[Array, Array] | None:
    """dω/dt (T, 3) rad/s² by differences and its inverse variance, zero where neighbours are
    missing; None for too few samples.

    late : (T, K, 3, 3) s as in `fusion.Sensed`: the rate that gyros have is that of their mean time
    """
    if len(t) < 2 * _WINDOW:
        return None
    rate, variance = _as_read(motion, late)
    step = np.diff(t)
    usual = float(np.median(step))
    near = np.abs(step - usual) < _SLOW * usual
    spin, own, bent = np.zeros_like(rate), np.full(rate.shape, np.inf), np.zeros_like(rate)
    span = (t[2:] - t[:-2])[:, None]
    spin[1:-1] = (rate[2:] - rate[:-2]) / span
    own[1:-1] = (variance[2:] + variance[:-2]) / span**2
    own[1:-1][~(near[1:] & near[:-1])] = np.inf
    third = np.diff(rate, n=3, axis=0) / (6.0 * usual)
    whole = near[2:] & near[1:-1] & near[:-2]
    bent[1:-2] = np.where(whole[:, None], third**2, 0.0)
    bent[2:-1] = np.maximum(bent[2:-1], bent[1:-2])
    error = _DOUBT**2 * _local(bent)
    # What the accelerometers see beside it, where that is more than noise: aliased motion.
    theirs = np.einsum("tii->ti", motion.covariance)[:, 3:6]
    known = np.isfinite(own)
    off = np.where(known, (spin - motion.spin) ** 2, 0.0)
    noise = np.where(known, theirs + own, 0.0) + error
    excess = _local(off) - _local(noise)
    error += np.where(_local(off) > _ODD * _local(noise), np.maximum(excess, 0.0), 0.0)
    return spin, 1.0 / (own + error)


def _as_read(motion: FusedMotion, late: Array | None) -> tuple[Array, Array]:
    """(T, 3) the rate at the gyros' mean time and its variance: the spin's noise is not in it."""
    variance = np.einsum("tii->ti", motion.covariance)
    if late is None:
        return motion.rate, variance[:, 6:]
    mean = np.einsum("tkii->t", late) / (3.0 * late.shape[1])
    rate = motion.rate + mean[:, None] * motion.spin
    cross = np.einsum("tii->ti", motion.covariance[:, 3:6, 6:])
    spread = variance[:, 6:] + 2.0 * mean[:, None] * cross + mean[:, None] ** 2 * variance[:, 3:6]
    return rate, np.maximum(spread, 0.0)


def _local(values: Array) -> Array:
    return np.asarray(uniform_filter1d(values, _WINDOW, axis=0, mode="nearest"))
