"""Rotations from angular rates: the attitude along a turn, and what small changes of the rate do.

R(t) turns the body's axes at t into those at the turn's start, R' = R [ω]x. A change δω of the rate
changes it by R(T) exp([R(T)' Q]x) to the first order, with the variational integral

    Q = ∫ R(t) δω(t) dt,

which depends on no direction that is carried: one pass over the samples serves every parameter.
"""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import rotations


def steps(t: Array, rate: Array) -> Array:
    """(n - 1, 3) rad, the rotation vector of each step of a body's rates (n, 3) rad/s at t (n,) s.

    The fourth-order Magnus expansion (Blanes et al., Phys. Rep. 470, 2009, section 5.3) of the
    cubic through both ends with their slopes: the commutator of the two ends is the coning term.
    """
    h = np.diff(t)[:, None]
    slope = np.gradient(rate, t, axis=0, edge_order=2 if len(t) > 2 else 1)
    if len(t) > 5 and np.ptp(h) < 0.2 * float(np.median(h)):
        wide = rate[4:] - rate[:-4]
        slope[2:-2] = (8.0 * (rate[3:-1] - rate[1:-3]) - wide) / (12.0 * float(np.median(h)))
    mean = 0.5 * h * (rate[:-1] + rate[1:]) + h**2 / 12.0 * (slope[:-1] - slope[1:])
    return np.asarray(mean + h**2 / 12.0 * np.cross(rate[:-1], rate[1:]))


def attitudes(t: Array, rate: Array) -> Array:
    """(n, 3, 3) R at every sample, the first being the identity; rate : (n, 3) rad/s at t (n,) s.

    Products are made in blocks of √n, so that no loop is longer than that.
    """
    each = rotations(steps(t, rate))
    n = len(each)
    block = max(1, int(np.sqrt(n)))
    count = -(-n // block)
    whole = np.tile(np.eye(3), (count * block, 1, 1))
    whole[:n] = each
    whole = whole.reshape(count, block, 3, 3)
    for i in range(1, block):
        whole[:, i] = whole[:, i - 1] @ whole[:, i]
    for j in range(1, count):
        whole[j] = whole[j - 1, -1] @ whole[j]
    return np.concatenate([np.eye(3)[None], whole.reshape(-1, 3, 3)[:n]])


def shares(t: Array) -> Array:
    """(n,) s, weight of every sample in an integral over t (n,) by trapezoids."""
    h = np.diff(t)
    return np.asarray(0.5 * (np.r_[h, 0.0] + np.r_[0.0, h]))


def between(first: Array, second: Array) -> Array:
    """(...) rad, angle between vectors (..., 3), exact for small ones too."""
    sine = np.linalg.norm(np.cross(first, second), axis=-1)
    return np.asarray(np.arctan2(sine, np.sum(first * second, axis=-1)))
