"""The rotation rate of each sample given positions: conditional mode, curvature, moments.

With s and ω̇ integrated out, minus the log density of one sample is, up to constants,

    f(ω) = ½ yy - ωᵀNω + |ω|² tr N + ½ |ω|² ωᵀJω - ½ vᵀKv + ½ (ω - g)ᵀP(ω - g)
    v = n - ω × Jω,   n = vee(N),   K = (J + Σ^-1)^-1,   ω̇ = Kv  (Euler's torque balance)

where J = Σ λ (|r|² I - r rᵀ) and N = Σ λ y rᵀ over the weighted-centred triads: the positions
enter through 6 numbers a geometry and 9 a sample. Everything is batched over B geometries and T
samples, arrays (B, ..., T) with the samples last.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
CYCLES = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
_EXACT = 1e-10  # Newton decrement (twice what f can still fall) at which a mode is final
_LONGEST = 60


@dataclass(frozen=True)
class Conditionals:
    """What f needs. moment : (B, 3, 3, T) N; inertia, gain : (B, 3, 3) J and K;
    power : (B, T) yy; rate : (3, T) g; precision : (3, 3, T or 1) P."""

    moment: Array
    inertia: Array
    gain: Array
    power: Array
    rate: Array
    precision: Array

    @property
    def torque(self) -> Array:
        """(B, 3, T) n."""
        n = self.moment
        return np.stack(
            [n[:, 2, 1] - n[:, 1, 2], n[:, 0, 2] - n[:, 2, 0], n[:, 1, 0] - n[:, 0, 1]], axis=1
        )

    def prepared(self) -> Prepared:
        double = self.moment + self.moment.transpose(0, 2, 1, 3)
        trace = self.moment[:, 0, 0] + self.moment[:, 1, 1] + self.moment[:, 2, 2]
        flat = -double
        for k in range(3):
            flat[:, k, k] += 2.0 * trace
        return Prepared(
            flat, self.torque, self.inertia, self.gain, self.power, self.rate[None], self.precision
        )


@dataclass(frozen=True)
class Prepared:
    """`Conditionals` with -2A = 2 tr N I - (N + Nᵀ) (B, 3, 3, T) and n (B, 3, T) worked out."""

    bend: Array
    torque: Array
    inertia: Array
    gain: Array
    power: Array
    rate: Array
    precision: Array

    def repeated(self, times: int) -> Prepared:
        """The same conditionals `times` over, along the batch."""

        def again(values: Array) -> Array:
            return np.concatenate([values] * times, axis=0)

        return replace(
            self, bend=again(self.bend), torque=again(self.torque), inertia=again(self.inertia),
            gain=again(self.gain), power=again(self.power),
        )  # fmt: skip


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
    for i, j, k in CYCLES:
        np.multiply(a[:, j], b[:, k], out=out[:, i])
        out[:, i] -= a[:, k] * b[:, j]
    return out


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2])


def _times(matrix: Array, vector: Array) -> Array:
    """(…, 3, 3, T) times (B, 3, T)."""
    m, v = matrix, vector[:, None]
    return np.asarray(m[..., 0, :] * v[..., 0, :] + m[..., 1, :] * v[..., 1, :]
                      + m[..., 2, :] * v[..., 2, :])  # fmt: skip


def local(given: Prepared, w: Array, *, curvature: bool = True) -> Local:
    """f, its gradient and (if asked) its Hessian at w (B, 3, T)."""
    jw = given.inertia @ w
    v = given.torque - cross(w, jw)
    a = given.gain @ v
    ww, wjw = _dot(w, w), _dot(w, jw)
    bent = _times(given.bend, w)
    off = w - given.rate
    pulled = _times(given.precision, off)
    value = 0.5 * (given.power + _dot(w, bent) + ww * wjw - _dot(v, a) + _dot(off, pulled))
    gradient = bent + w * wjw[:, None] + jw * ww[:, None] + pulled
    gradient += cross(jw, a) - given.inertia @ cross(w, a)
    if not curvature:
        return Local(value, gradient, a, np.empty(0))
    return Local(value, gradient, a, _hessian(given, w, jw, a, ww, wjw))


def _hessian(given: Prepared, w: Array, jw: Array, a: Array, ww: Array, wjw: Array) -> Array:
    b, _, t = w.shape
    inertia = given.inertia[..., None]
    turn = np.empty((b, 3, 3, t))  # D = dv/dω, by columns
    spun = np.empty((b, 3, 3, t))  # Ω(a) J, by columns
    for c in range(3):
        column = inertia[:, :, c]
        spun[:, :, c] = cross(a, column)
        turn[:, :, c] = cross(column, w)
    for i, j, k in CYCLES:
        turn[:, i, j] -= jw[:, k]
        turn[:, j, i] += jw[:, k]
    gained = (given.gain @ turn.reshape(b, 3, 3 * t)).reshape(b, 3, 3, t)
    outer = 2.0 * w[:, :, None] * jw[:, None]
    h = given.bend + given.precision + inertia * ww[:, None, None]
    h = h + outer + outer.transpose(0, 2, 1, 3) - spun - spun.transpose(0, 2, 1, 3)
    for k in range(3):
        h[:, k, k] += wjw
        h -= turn[:, k, :, None] * gained[:, k, None]
    return np.asarray(h)


def inverse(h: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Inverse (B, 3, 3, T) and determinant (B, T) of symmetric matrices, and which are positive."""
    xx, yy, zz = h[:, 0, 0], h[:, 1, 1], h[:, 2, 2]
    xy, xz, yz = h[:, 0, 1], h[:, 0, 2], h[:, 1, 2]
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    det = xx * a + xy * b + xz * c
    out = np.empty_like(h)
    out[:, 0, 0], out[:, 1, 1], out[:, 2, 2] = a, xx * zz - xz * xz, xx * yy - xy * xy
    out[:, 0, 1] = out[:, 1, 0] = b
    out[:, 0, 2] = out[:, 2, 0] = c
    out[:, 1, 2] = out[:, 2, 1] = xy * xz - yz * xx
    positive = (xx > 0.0) & (out[:, 2, 2] > 0.0) & (det > 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        out /= det[:, None, None]
    return out, det, positive


def modes(given: Prepared, start: Array) -> tuple[Array, Local]:
    """Conditional modes (B, 3, T) from `start` (3, T) and f there, by safeguarded Newton.

    Plain steps first for all; the few samples that would climb are finished one by one with a
    positive-definite shift and step halving.
    """
    b = len(given.inertia)
    w = np.broadcast_to(start, (b, *start.shape)).copy()
    here = local(given, w)
    for _ in range(_LONGEST):
        inverted, _, positive = inverse(here.hessian)
        step = -_times(inverted, here.gradient)
        decrement = -_dot(here.gradient, step)
        sound = bool(positive.all())
        if sound and float(decrement.max(initial=0.0)) < _EXACT:
            return w, here
        if not sound:
            step = _shifted(here, step, positive)
        there = local(given, w + step)
        noise = 1e-13 * (np.abs(here.value) + given.power) + 1e-12
        worse = ~(there.value <= here.value + noise)
        for _ in range(40):
            if not worse.any():
                break
            step = np.where(worse[:, None], 0.5 * step, step)
            there = local(given, w + step)
            worse = ~(there.value <= here.value + noise)
        moved = np.abs(step).max(axis=1) > 1e-14 * (1.0 + np.abs(w).max(axis=1))
        w, here = w + step, there
        if not moved.any():
            return w, here
    return w, here


def _shifted(here: Local, step: Array, positive: NDArray[np.bool_]) -> Array:
    """Steps with a shifted Hessian where it is not positive definite."""
    b, t = np.nonzero(~positive)
    h = here.hessian[b, :, :, t]
    values, vectors = np.linalg.eigh(h)
    size = np.abs(values).max(axis=1, keepdims=True)
    values = np.maximum(np.abs(values), 1e-3 * size)
    g = here.gradient[b, :, t]
    turned = np.einsum("nij,ni->nj", vectors, g) / values
    out = step.copy()
    out[b, :, t] = -np.einsum("nij,nj->ni", vectors, turned)
    return out
