"""The rotation rate of each sample given positions: conditional mode, curvature, moments.

With s and ω̇ integrated out, minus the log density of one sample is, up to constants,

    f(ω) = ½ yy - ωᵀNω + |ω|² tr N + ½ |ω|² ωᵀJω - ½ vᵀKv + ½ (ω - g)ᵀP(ω - g)
    v = n - ω × Jω,   n = vee(N),   K = (J + Σ^-1)^-1,   ω̇ = Kv  (Euler's torque balance)

where J = Σ λ (|r|² I - r rᵀ) and N = Σ λ y rᵀ over the weighted-centred triads: the positions
enter through 6 numbers a geometry and 9 a sample. Everything is batched over B geometries and T
samples, arrays (B, ..., T) with the samples last, which is several times faster than matrix by
matrix.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.core.eigen import eigen
from imucalib.estimators.array.samples import lower_triangle

_EXACT = 1e-8  # Newton decrement below which the rest is taken by the parabola at the point
_LONGEST = 60


@dataclass(frozen=True)
class Conditionals:
    """What f needs. bend : (B, 3, 3, T) 2 tr N I - (N + Nᵀ); torque : (B, 3, T) n; inertia, gain :
    (B, 3, 3) J and K; power : (B, T) yy; rate : (3, T) g; precision : (3, 3, T or 1) P."""

    bend: Array
    torque: Array
    inertia: Array
    gain: Array
    power: Array
    rate: Array
    precision: Array

    def repeated(self, times: int) -> Conditionals:
        """The same `times` over, along the batch."""
        names = ("bend", "torque", "inertia", "gain", "power")
        return replace(self, **{n: np.concatenate([getattr(self, n)] * times) for n in names})


@dataclass(frozen=True)
class Local:
    """f (B, T), gradient (B, 3, T), ω̇ (B, 3, T) and Hessian (B, 3, 3, T) at ω."""

    value: Array
    gradient: Array
    spin: Array
    hessian: Array


def cross(a: Array, b: Array) -> Array:
    """a × b along the second axis."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(a[:, j], b[:, k], out=out[:, i])
        out[:, i] -= a[:, k] * b[:, j]
    return out


def skew(a: Array) -> Array:
    """(B, 3, 3, T) with skew(a) b = a × b, of (B, 3, T)."""
    out = np.zeros((len(a), 3, 3, a.shape[2]))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[:, k, j], out[:, j, k] = a[:, i], -a[:, i]
    return out


def dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("bit,bit->bt", a, b))


def outer(a: Array, b: Array) -> Array:
    return a[:, :, None] * b[:, None]


def times(matrix: Array, vector: Array) -> Array:
    """Matrices (..., 3, 3, T) times (B, 3, T)."""
    return np.asarray(np.einsum("...ijt,...jt->...it", matrix, vector))


def local(given: Conditionals, w: Array, *, curvature: bool = True) -> Local:
    """f, its gradient and (with curvature) its Hessian at w (B, 3, T)."""
    jw = given.inertia @ w
    v = given.torque - cross(w, jw)
    spin = given.gain @ v
    square, along = dot(w, w)[:, None], dot(w, jw)[:, None]
    bent = times(given.bend, w)
    off = w - given.rate
    pulled = times(given.precision, off)
    value = dot(w, bent) - dot(v, spin) + dot(off, pulled) + given.power
    value = 0.5 * (value + (square * along)[:, 0])
    slope = skew(jw) - _times_each(skew(w), given.inertia)  # dv/dω
    gradient = bent + along * w + square * jw + pulled
    gradient -= np.einsum("bjit,bjt->bit", slope, spin)
    if not curvature:
        return Local(value, gradient, spin, np.empty(0))
    mixed = outer(2.0 * w, jw) - _times_each(skew(spin), given.inertia)
    hessian = given.bend + mixed + mixed.swapaxes(1, 2)
    hessian += square[:, None] * given.inertia[..., None]
    hessian += along[:, None] * np.eye(3)[..., None] + given.precision
    gained = (given.gain @ slope.reshape(len(w), 3, -1)).reshape(slope.shape)
    hessian -= np.einsum("bkit,bkjt->bijt", slope, gained)
    return Local(value, gradient, spin, hessian)


def _times_each(left: Array, right: Array) -> Array:
    """Matrices (B, 3, 3, T) times (B, 3, 3)."""
    return np.asarray(np.einsum("bikt,bkj->bijt", left, right))


def inverse(h: Array) -> tuple[Array, Array, Flags]:
    """Inverse (B, 3, 3, T) and determinant (B, T) of symmetric matrices, and which are positive."""
    x, y, z = h[:, 0], h[:, 1], h[:, 2]
    cofactors = np.stack([cross(y, z), cross(z, x), cross(x, y)], axis=1)
    det = dot(x, cofactors[:, 0])
    positive = (h[:, 0, 0] > 0.0) & (cofactors[:, 2, 2] > 0.0) & (det > 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return cofactors / det[:, None, None], det, positive


def root_of(m: Array) -> Array:
    """Lower triangles (B, 3, 3, T) whose squares are positive matrices (B, 3, 3, T)."""
    b, _, _, t = m.shape
    with np.errstate(invalid="ignore"):
        found = lower_triangle(m.transpose(1, 2, 0, 3).reshape(3, 3, b * t))
    return found.reshape(3, 3, b, t).transpose(2, 0, 1, 3)


@dataclass(frozen=True)
class Mode:
    """rate : (B, 3, T) conditional modes, up to a step that no longer counts; here : f there, its
    value lowered by what that step is worth; covariance, det, positive : of `inverse`."""

    rate: Array
    here: Local
    covariance: Array
    det: Array
    positive: Flags


def modes(given: Conditionals, start: Array) -> Mode:
    """Conditional modes from `start` (3, T) or (B, 3, T), by safeguarded Newton.

    Plain steps first for all; the few samples that would climb are finished one by one with a
    positive-definite shift and step halving.
    """
    w = np.broadcast_to(start, (len(given.inertia), *start.shape[-2:]))
    here = local(given, w)
    for _ in range(_LONGEST):
        covariance, det, positive = inverse(here.hessian)
        step = -times(covariance, here.gradient)
        decrement = -dot(here.gradient, step)
        if not positive.all():
            step = _shifted(here, step, positive)
        elif float(decrement.max(initial=0.0)) < _EXACT:
            lower = replace(here, value=here.value - 0.5 * decrement)
            return Mode(w, lower, covariance, det, positive)
        there = local(given, w + step)
        noise = 1e-13 * (np.abs(here.value) + given.power) + 1e-12
        for _ in range(40):
            worse = ~(there.value <= here.value + noise)
            if not worse.any():
                break
            step = np.where(worse[:, None], 0.5 * step, step)
            there = local(given, w + step)
        moved = np.abs(step).max(axis=1) > 1e-14 * (1.0 + np.abs(w).max(axis=1))
        w, here = w + step, there
        if not moved.any():
            break
    return Mode(w, here, *inverse(here.hessian))


def _shifted(here: Local, step: Array, positive: Flags) -> Array:
    """Steps with a shifted Hessian where it is not positive definite."""
    b, t = np.nonzero(~positive)
    values, vectors = eigen(here.hessian[b, :, :, t])
    size = np.abs(values).max(axis=1, keepdims=True)
    values = np.maximum(np.abs(values), 1e-3 * size)
    turned = np.einsum("nij,ni->nj", vectors, here.gradient[b, :, t]) / values
    out = step.copy()
    out[b, :, t] = -np.einsum("nij,nj->ni", vectors, turned)
    return out
