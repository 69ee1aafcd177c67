"""One motion from many IMUs: specific force, angular acceleration and rate of every sample.

A triad at r feels s + W r, W = Ω(ω)² + Ω(dω/dt), and its gyro reads ω: nine unknowns a sample, each
axis weighted by itself. What the readings say of (s, W) are twelve numbers and a 12 × 12 matrix,
made once whatever the number of IMUs; Gauss-Newton runs on these (equations 4a and 4b of paper
001; maximum likelihood as in Skog, Nilsson, Händel, Nehorai 2016, IEEE Trans. Signal Process. 64).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.estimators.array.samples import (
    SPIN,
    Information,
    places,
    slope_by_motion,
    turning,
)

#: rad/s, standard deviation about the start: far beyond what moves by hand, so that it only matters
#: where the readings leave a direction open.
_RATE = 200.0
_ROUNDS, _CLOSE = 25, 1e-6  # steps at most, and rad/s at which a rate is settled
_LONGEST = 5.0  # rad/s of one step where the rate hangs on its square


@dataclass(frozen=True)
class Sensed:
    """What K triads say in T samples, in board axes.

    force, rate : (T, K, 3) m/s² and rad/s; force_precision, rate_precision : (T, K, 3, 3) inverse
        covariances, without rank along axes that do not count
    late : (T, K, 3, 3) s or None: a gyro reads ω + late dω/dt
    spin, spin_precision : (T, 3) what else is known of dω/dt, rad/s² and its inverse variance
    """

    force: Array
    rate: Array
    force_precision: Array
    rate_precision: Array
    late: Array | None = None
    spin: Array | None = None
    spin_precision: Array | None = None

    def take(self, rows: Index) -> Sensed:
        """What they say in some of the samples."""
        values: list[Any] = [None if v is None else v[rows] for v in vars(self).values()]
        return Sensed(*values)


@dataclass(frozen=True)
class FusedMotion:
    """force, spin, rate : (T, 3) s at the origin of the positions (m/s²), dω/dt (rad/s²) and ω
    (rad/s); covariance : (T, 9, 9) of the nine in this order"""

    force: Array
    spin: Array
    rate: Array
    covariance: Array

    def predict_force(self, r: Array) -> Array:
        """(T, K, 3) m/s² specific force at places r (K, 3) m."""
        return np.asarray(self.force[:, None] + r @ turning(self.rate, self.spin).swapaxes(1, 2))

    def take(self, rows: slice | Index) -> FusedMotion:
        """The motion of some samples."""
        return FusedMotion(*(v[rows] for v in vars(self).values()))

    def put(self, rows: Index, other: FusedMotion) -> FusedMotion:
        """With other motions of some samples."""
        whole = [v.copy() for v in vars(self).values()]
        for v, part in zip(whole, vars(other).values(), strict=True):
            v[rows] = part
        return FusedMotion(*whole)

    def doubt(self, r: Array) -> Array:
        """(T, K) mean variance of an axis of `felt`, (m/s²)²."""
        place, slope = places(r)[0], slope_by_motion(self.rate)
        whole = slope @ self.covariance @ slope.swapaxes(1, 2)
        each = np.einsum("tiaib->tab", whole.reshape(-1, 3, 4, 3, 4))
        return np.asarray(np.einsum("ka,tab,kb->tk", place, each, place, optimize=True) / 3.0)

    def doubt_of_rate(self, late: Array | None) -> Array:
        """(T, K) or (T, 1) mean variance of an axis of what gyros should read, (rad/s)²."""
        own = np.einsum("tii->t", self.covariance[:, 6:, 6:])[:, None] / 3.0
        if late is None:
            return np.asarray(own)
        cross = np.einsum("tkij,tij->tk", late, self.covariance[:, 3:6, 6:])
        inner = np.einsum(
            "tkij,tjl,tkil->tk", late, self.covariance[:, 3:6, 3:6], late, optimize=True
        )
        return np.asarray(own + (2.0 * cross + inner) / 3.0)


def compute_precision(axes: Array, weight: Array) -> Array:
    """(T, K, 3, 3) inverse covariances in board axes.

    axes : (K, 3, 3), in its rows what each axis senses of a vector in board axes
    weight : (T, K, 3) inverse variances of the axes' readings, zero for one that does not count
    """
    squares = (axes[:, :, :, None] * axes[:, :, None, :]).reshape(len(axes), 3, 9)
    made = np.matmul(weight.transpose(1, 0, 2), squares)
    return np.asarray(made.transpose(1, 0, 2).reshape(*weight.shape, 3))


def fuse_samples(sensed: Sensed, r: Array, start: Array) -> FusedMotion:
    """The best motion of every sample.

    r : (K, 3) m, positions about the point whose force is wanted; start : (T, 3) rad/s
    """
    (t, k), (place, pairs) = sensed.force.shape[:2], places(r)
    weights = sensed.force_precision.reshape(t, k, 9).transpose(0, 2, 1)
    normal = np.matmul(weights, pairs).reshape(t, 3, 3, 4, 4).transpose(0, 1, 3, 2, 4)
    pulled = np.matmul(sensed.force_precision, sensed.force[..., None])[..., 0]
    along = np.matmul(pulled.transpose(0, 2, 1), place)
    own, pull = _inform_by_gyros(sensed, start)
    said = Information(normal.reshape(t, 12, 12), along.reshape(t, 12), own, pull)
    first = np.concatenate([np.zeros((t, 6)), start], axis=1)
    x, root = said.fit(first, _ROUNDS, _CLOSE, _LONGEST)
    return FusedMotion(x[:, :3], x[:, 3:6], x[:, 6:], root @ root.transpose(0, 2, 1))


def _inform_by_gyros(sensed: Sensed, start: Array) -> tuple[Array, Array]:
    """What gyros and priors say of dω/dt and ω: (T, 6, 6) and (T, 6)."""
    own, pull = np.zeros((len(start), 6, 6)), np.zeros((len(start), 6))
    own[:, range(3), range(3)] = SPIN
    own[:, 3:, 3:] = sensed.rate_precision.sum(axis=1) + np.eye(3) / _RATE**2
    pulled = np.matmul(sensed.rate_precision, sensed.rate[..., None])
    pull[:, 3:] = pulled[..., 0].sum(axis=1) + start / _RATE**2
    if sensed.late is not None:
        back = sensed.late.swapaxes(2, 3)
        cross = np.matmul(back, sensed.rate_precision)
        own[:, :3, 3:] = cross.sum(axis=1)
        own[:, 3:, :3] = own[:, :3, 3:].swapaxes(1, 2)
        own[:, :3, :3] += np.matmul(cross, sensed.late).sum(axis=1)
        pull[:, :3] += np.matmul(back, pulled)[..., 0].sum(axis=1)
    if sensed.spin is not None and sensed.spin_precision is not None:
        own[:, range(3), range(3)] += sensed.spin_precision
        pull[:, :3] += sensed.spin_precision * sensed.spin
    return own, pull
