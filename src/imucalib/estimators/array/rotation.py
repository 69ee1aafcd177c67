"""The rotation rate of each sample given positions: conditional mode, curvature, moments.

With s and ω̇ integrated out, minus the log density of one sample is, up to constants,

    f(ω) = ½ yy - ωᵀNω + |ω|² tr N + ½ |ω|² ωᵀJω - ½ vᵀKv + ½ (ω - g)ᵀP(ω - g)
    v = n - ω × Jω,   n = vee(N),   K = (J + Σ^-1)^-1,   ω̇ = Kv  (Euler's torque balance)

where J = Σ λ (|r|² I - r rᵀ) and N = Σ λ y rᵀ over the weighted-centred triads: the positions
enter through 6 numbers a geometry and 9 a sample. Everything is batched over B geometries and T
samples, arrays (B, ..., T) with the samples last; symmetric matrices are their six numbers in
the order of `SIX`. What is linear in ω or in its products is one small matrix product a geometry.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from imucalib.arrays import Array

CYCLES = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
SIX = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_PLACES = [3 * i + j for i, j in SIX]
LINE = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])  # where element (i, j) is among the six


@dataclass(frozen=True)
class Conditionals:
    """What f needs. moment : (B, 3, 3, T) N, [.., i, j, ..] of y_i r_j; inertia, gain :
    (B, 3, 3) J and K; power : (B, T) yy; rate : (3, T) g; precision : (6, T or 1) P."""

    moment: Array
    inertia: Array
    gain: Array
    power: Array
    rate: Array
    precision: Array

    def prepared(self) -> Prepared:
        n = self.moment
        b, _, _, t = n.shape
        bend, torque = np.empty((b, 6, t)), np.empty((b, 3, t))
        for i, j, k in CYCLES:
            np.add(n[:, i, i], n[:, j, j], out=bend[:, k])
            np.add(n[:, i, j], n[:, j, i], out=bend[:, LINE[i, j]])
            np.subtract(n[:, k, j], n[:, j, k], out=torque[:, i])
        bend[:, :3] *= 2.0
        np.negative(bend[:, 3:], out=bend[:, 3:])
        return Prepared(
            bend=bend,
            torque=torque,
            inertia=self.inertia,
            gain=self.gain,
            linear=_linear(self.inertia, self.gain),
            quadratic=_of(self.inertia, _quadratic),
            spun=_of(self.inertia, _spun),
            power=self.power,
            rate=self.rate[None],
            precision=self.precision,
        )


@dataclass(frozen=True)
class Prepared:
    """`Conditionals` with 2 tr N I - (N + Nᵀ) (B, 6, T) and n (B, 3, T) worked out, and the maps

    linear : (B, 21, 3) ω to Jω, D = dv/dω and KD, row by row
    quadratic : (B, 6, 6) the products of ω to the Hessian of ½ |ω|² ωᵀJω
    spun : (B, 6, 3) ω̇ to the symmetric part, doubled, of Ω(ω̇)J
    """

    bend: Array
    torque: Array
    inertia: Array
    gain: Array
    linear: Array
    quadratic: Array
    spun: Array
    power: Array
    rate: Array
    precision: Array

    def repeated(self, times: int) -> Prepared:
        """The same conditionals `times` over, along the batch."""
        names = ("bend", "torque", "inertia", "gain", "linear", "quadratic", "spun", "power")
        again = {n: np.concatenate([getattr(self, n)] * times, axis=0) for n in names}
        return replace(self, **again)


def _linear(inertia: Array, gain: Array) -> Array:
    b = len(inertia)
    slope = _of(inertia, _slope).reshape(b, 3, 9)
    gained = (gain @ slope).reshape(b, 9, 3)
    return np.concatenate([inertia, slope.reshape(b, 9, 3), gained], axis=1)


def _of(inertia: Array, made: Callable[[Array], Array]) -> Array:
    """(B, ...) what is linear in the inertia (B, 3, 3), of which nine matrices tell all."""
    table, shape = _table(made)
    return (inertia.reshape(-1, 9) @ table).reshape(-1, *shape)


@cache
def _table(made: Callable[[Array], Array]) -> tuple[Array, tuple[int, ...]]:
    each = made(np.eye(9).reshape(9, 3, 3))
    return each.reshape(9, -1), each.shape[1:]


def _slope(inertia: Array) -> Array:
    """(B, 3, 3, 3) D = Ω(Jω) - Ω(ω)J: [.., i, c, m] of ω_m."""
    slope = np.zeros((len(inertia), 3, 3, 3))
    for i, j, k in CYCLES:
        slope[:, i, j] -= inertia[:, k]
        slope[:, j, i] += inertia[:, k]
        slope[:, i, :, k] += inertia[:, j]
        slope[:, i, :, j] -= inertia[:, k]
    return slope


def _quadratic(inertia: Array) -> Array:
    out = np.zeros((len(inertia), 6, 6))
    for s, (i, j) in enumerate(SIX):
        out[:, s, :3] += inertia[:, i, j, None]
        for m in range(3):
            out[:, s, LINE[i, m]] += 2.0 * inertia[:, j, m]
            out[:, s, LINE[j, m]] += 2.0 * inertia[:, i, m]
            if i == j:
                out[:, s, m] += inertia[:, m, m]
                out[:, s, LINE[m, (m + 1) % 3]] += 2.0 * inertia[:, m, (m + 1) % 3]
    return out


def _spun(inertia: Array) -> Array:
    # Ω(a)J: element (i, c) is a_j J_kc - a_k J_jc for (i, j, k) in cyclic order.
    b = len(inertia)
    full = np.zeros((b, 3, 3, 3))
    for i, j, k in CYCLES:
        full[:, i, :, j] += inertia[:, k]
        full[:, i, :, k] -= inertia[:, j]
    return np.stack([full[:, i, j] + full[:, j, i] for i, j in SIX], axis=1)


@dataclass(frozen=True)
class Local:
    """f (B, T), gradient (B, 3, T), ω̇ (B, 3, T) and Hessian (B, 6, T) at ω."""

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


def full(six: Array) -> Array:
    """(..., 3, 3, T) of symmetric matrices (..., 6, T)."""
    return np.asarray(six[..., LINE, :])


def dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("bit,bit->bt", a, b))


def times(six: Array, vector: Array) -> Array:
    """Symmetric (…, 6, T) times (B, 3, T)."""
    x, y, z = vector[:, 0], vector[:, 1], vector[:, 2]
    out = np.empty(vector.shape)
    for i, line in enumerate(LINE):
        np.multiply(six[..., line[0], :], x, out=out[:, i])
        out[:, i] += six[..., line[1], :] * y
        out[:, i] += six[..., line[2], :] * z
    return out


def products(w: Array) -> Array:
    """(B, 6, T) products of the elements of w (B, 3, T)."""
    out = np.empty((len(w), 6, w.shape[2]))
    np.multiply(w, w, out=out[:, :3])
    for s in (3, 4, 5):
        np.multiply(w[:, SIX[s][0]], w[:, SIX[s][1]], out=out[:, s])
    return out


def local(given: Prepared, w: Array, *, curvature: bool = True) -> Local:
    """f, its gradient and (if asked) its Hessian at w (B, 3, T)."""
    ww = products(w)
    slopes = (given.linear if curvature else given.linear[:, :12]) @ w
    jw = slopes[:, :3]
    v = given.torque - cross(w, jw)
    a = given.gain @ v
    # Of a quartic q, ∇q = ∇∇q w / 3 and q = wᵀ∇q / 4.
    h = given.quadratic @ ww
    stiff = h * (1.0 / 3.0)
    stiff += given.bend
    gradient = times(stiff, w)
    off = w - given.rate
    pulled = times(given.precision, off)
    value = dot(w, gradient)
    value -= (ww[:, 0] + ww[:, 1] + ww[:, 2]) * dot(w, jw)
    value -= dot(v, a)
    value += dot(off, pulled)
    value += given.power
    value *= 0.5
    gradient += pulled
    bent = slopes[:, 3:12].reshape(len(w), 3, 3, -1)  # D
    gradient -= np.einsum("bict,bit->bct", bent, a)
    if not curvature:
        return Local(value, gradient, a, np.empty(0))
    h += given.bend
    h += given.precision
    h -= given.spun @ a
    curved = np.einsum("bkit,bkjt->bijt", bent, slopes[:, 12:].reshape(bent.shape))
    h -= curved.reshape(len(w), 9, -1)[:, _PLACES]
    return Local(value, gradient, a, h)
