"""The motion of each sample given positions, with every reading weighted by itself.

Nine unknowns a sample: s (specific force of the first triad), dω/dt and ω, by Gauss-Newton. What is
kept of it (`Sampled`) is all that a score test needs to take the motion out of any column.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array

_ROUNDS = 12
#: rad/s, a last step: forces are linear in all but ω, and of its square 1e-8 m/s² is left.
_LAST = 1e-3
#: (rad/s²)^-2, of dω/dt about zero: 3e6 deg/s², a hundred times what hands do. IMUs on one line say
#: nothing of the spin about it, and this alone keeps that one number finite.
_SPIN = np.deg2rad(3e6) ** -2.0


@dataclass(frozen=True)
class Readings:
    """acceleration (m/s²) and rate (rad/s) : (T, K, 3), board axes."""

    acceleration: Array
    rate: Array

    def take(self, rows: NDArray[np.intp]) -> Readings:
        return Readings(self.acceleration[rows], self.rate[rows])


@dataclass(frozen=True)
class Weights:
    """Inverse variances (T, K) of each triad's axes: (m/s²)^-2 and (rad/s)^-2."""

    acceleration: Array
    rate: Array


@dataclass(frozen=True)
class Sampled:
    """Positions' best motion and what it leaves.

    rate, spin, origin : (T, 3) ω, dω/dt and s; force : (T, K, 3) predicted specific force
    turn : (T, 3, 3) W, the derivative of a force by its position
    off : residuals; weights : what they were weighted by
    arms : (T, K, 3, 9) derivative of the forces by s, dω/dt, ω; root : (T, 9, 9) with
        root rootᵀ the covariance of the nine
    """

    rate: Array
    spin: Array
    origin: Array
    force: Array
    turn: Array
    off: Readings
    weights: Weights
    arms: Array
    root: Array

    @property
    def left(self) -> tuple[Array, Array]:
        """(T, K) shares of the variance of a triad's axis that its residual keeps."""
        inner = np.matmul(self.arms, self.root[:, None])
        acceleration = np.einsum("tkij,tkij->tk", inner, inner) * self.weights.acceleration / 3.0
        own = np.einsum("tij,tij->t", self.root[:, 6:], self.root[:, 6:])
        rate = own[:, None] * self.weights.rate / 3.0
        floor = 0.02
        return np.maximum(1.0 - acceleration, floor), np.maximum(1.0 - rate, floor)


def _skew(v: Array) -> Array:
    out = np.zeros((*v.shape[:-1], 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i, j], out[..., j, i] = -v[..., k], v[..., k]
    return out


def turning(rate: Array, spin: Array) -> Array:
    """(T, 3, 3) W = Ω(ω)² + Ω(dω/dt)."""
    square = rate[:, :, None] * rate[:, None]
    trace = np.sum(rate * rate, axis=1)[:, None, None] * np.eye(3)
    return np.asarray(square - trace + _skew(spin))


def _arms(rate: Array, r: Array) -> Array:
    """(T, K, 3, 9) derivative of s + W r by s, dω/dt and ω."""
    t, k = len(rate), len(r)
    out = np.zeros((t, k, 3, 9))
    out[..., :3] = np.eye(3)
    out[..., 3:6] = -_skew(r)
    along = (rate @ r.T)[..., None, None] * np.eye(3)
    outer = rate[:, None, :, None] * r[:, None, :]
    out[..., 6:] = along + outer - 2.0 * outer.swapaxes(2, 3)
    return out


def fit_samples(readings: Readings, weights: Weights, r: Array, start: Array | Sampled) -> Sampled:
    """Best motion of every sample; start : (T, 3) rad/s, or the motion of a fit nearby."""
    rate = start.rate if isinstance(start, Sampled) else start
    count = readings.acceleration.shape[1]
    own = weights.rate.sum(axis=1)
    unknown = np.zeros((len(rate), 9))
    if isinstance(start, Sampled):
        unknown[:, :3], unknown[:, 3:6] = start.origin, start.spin
    for _ in range(_ROUNDS):
        arms = _arms(rate, r)
        turn = turning(rate, unknown[:, 3:6])
        force = unknown[:, None, :3] + np.einsum("tij,kj->tki", turn, r)
        off = Readings(readings.acceleration - force, readings.rate - rate[:, None])
        flat = arms.reshape(len(rate), 3 * count, 9)
        heavy = (arms * weights.acceleration[..., None, None]).reshape(flat.shape)
        normal = np.matmul(heavy.transpose(0, 2, 1), flat)
        normal[:, range(3, 6), range(3, 6)] += _SPIN
        normal[:, range(6, 9), range(6, 9)] += own[:, None]
        right = np.matmul(heavy.transpose(0, 2, 1), off.acceleration.reshape(len(rate), -1, 1))
        right[:, 3:6, 0] -= _SPIN * unknown[:, 3:6]
        right[:, 6:, 0] += np.einsum("tk,tki->ti", weights.rate, off.rate)
        # In like units: a spin that only its prior holds is a small number beside the others.
        size = 1.0 / np.sqrt(np.einsum("tii->ti", normal))
        unit = normal * size[:, :, None] * size[:, None]
        step = size * np.linalg.solve(unit, right * size[:, :, None])[:, :, 0]
        unknown = unknown + step
        rate = rate + step[:, 6:]
        if float(np.abs(step[:, 6:]).max(initial=0.0)) < _LAST:
            break
    force = force + np.matmul(flat, step[:, :, None]).reshape(force.shape)
    off = Readings(readings.acceleration - force, readings.rate - rate[:, None])
    return Sampled(
        rate=rate,
        spin=unknown[:, 3:6],
        origin=unknown[:, :3],
        force=force,
        turn=turning(rate, unknown[:, 3:6]),
        off=off,
        weights=weights,
        arms=arms,
        root=_root(normal),
    )


def _root(normal: Array) -> Array:
    """(T, 9, 9) with root rootᵀ the inverse of each matrix, upper triangular."""
    scale = 1.0 / np.sqrt(np.einsum("tii->ti", normal))
    unit = normal * scale[:, :, None] * scale[:, None]
    return np.asarray(np.linalg.inv(np.linalg.cholesky(unit)).transpose(0, 2, 1)
                      * scale[:, :, None])  # fmt: skip


def reweighed(sampled: Sampled, acceleration: float, rate: float) -> Sampled:
    """The same motion with all weights of each kind of sensor times a factor."""
    weights = Weights(sampled.weights.acceleration * acceleration, sampled.weights.rate * rate)
    flat = sampled.arms.reshape(len(sampled.rate), -1, 9)
    heavy = (sampled.arms * weights.acceleration[..., None, None]).reshape(flat.shape)
    normal = np.matmul(heavy.transpose(0, 2, 1), flat)
    normal[:, range(3, 6), range(3, 6)] += _SPIN
    normal[:, range(6, 9), range(6, 9)] += weights.rate.sum(axis=1)[:, None]
    return replace(sampled, weights=weights, root=_root(normal))
