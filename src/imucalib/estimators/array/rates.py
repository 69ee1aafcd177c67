"""The conditional mode of each sample's rotation rate, and the covariance there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.core.eigen import eigen
from imucalib.estimators.array.rotation import LINE, Local, Prepared, dot, local, times

_EXACT = 1e-8  # Newton decrement below which the rest is taken by the parabola at the point
_LONGEST = 60


def inverse(h: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Inverse (B, 6, T) and determinant (B, T) of symmetric matrices, and which are positive."""
    xx, yy, zz, xy, xz, yz = (h[:, s] for s in range(6))
    out = np.empty_like(h)
    for s, (p, q, r, u) in enumerate(
        (
            (yy, zz, yz, yz),
            (xx, zz, xz, xz),
            (xx, yy, xy, xy),
            (xz, yz, xy, zz),
            (xy, yz, xz, yy),
            (xy, xz, yz, xx),
        )
    ):
        np.multiply(p, q, out=out[:, s])
        out[:, s] -= r * u
    det = xx * out[:, 0]
    det += xy * out[:, 3]
    det += xz * out[:, 4]
    positive = (xx > 0.0) & (out[:, 2] > 0.0) & (det > 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        out /= det[:, None]
    return out, det, positive


def cholesky_last(m: Array) -> Array:
    """Lower Cholesky factor (B, 3, 3, T) of positive matrices (B, 6, T)."""
    out = np.zeros((len(m), 3, 3, m.shape[2]))
    with np.errstate(invalid="ignore"):
        out[:, 0, 0] = np.sqrt(m[:, 0])
        out[:, 1, 0], out[:, 2, 0] = m[:, 3] / out[:, 0, 0], m[:, 4] / out[:, 0, 0]
        out[:, 1, 1] = np.sqrt(m[:, 1] - out[:, 1, 0] ** 2)
        out[:, 2, 1] = (m[:, 5] - out[:, 2, 0] * out[:, 1, 0]) / out[:, 1, 1]
        out[:, 2, 2] = np.sqrt(m[:, 2] - out[:, 2, 0] ** 2 - out[:, 2, 1] ** 2)
    return out


@dataclass(frozen=True)
class Mode:
    """rate : (B, 3, T) conditional modes, up to a step that no longer counts; here : f there, its
    value lowered by what that step is worth; covariance, det, positive : of `inverse`."""

    rate: Array
    here: Local
    covariance: Array
    det: Array
    positive: NDArray[np.bool_]


@dataclass(frozen=True)
class Lean:
    """How conditional modes follow the unknowns, to first order: what a Newton step would find from
    the mode of `centre` (d,), without its gradient. slope : (d, 3 T) rad/s per unit"""

    centre: Array
    slope: Array

    def rates(self, x: Array) -> Array:
        """(B, 3, T) rad/s beyond the modes of the centre, for unknowns (B, d)."""
        return np.asarray(((x - self.centre) @ self.slope).reshape(len(x), 3, -1))


def modes(given: Prepared, start: Array, metric: Array | None = None) -> Mode:
    """Conditional modes from `start` (3, T) or (B, 3, T), by safeguarded Newton.

    metric : (6, T) inverse Hessians near the start, if known, for a first step without Hessian.
    Plain steps first for all; the few samples that would climb are finished one by one with a
    positive-definite shift and step halving.
    """
    b = len(given.inertia)
    w = np.broadcast_to(start, (b, *start.shape[-2:]))
    if metric is not None:
        w = w - times(metric, local(given, w, curvature=False).gradient)
    here = local(given, w)
    for _ in range(_LONGEST):
        found = inverse(here.hessian)
        step = times(found[0], here.gradient)
        decrement = dot(here.gradient, step)
        np.negative(step, out=step)
        sound = bool(found[2].all())
        if sound and float(decrement.max(initial=0.0)) < _EXACT:
            lower = replace(here, value=here.value - 0.5 * decrement)
            return Mode(w, lower, *found)
        if not sound:
            step = _shifted(here, step, found[2])
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
            break
    return Mode(w, here, *inverse(here.hessian))


def _shifted(here: Local, step: Array, positive: NDArray[np.bool_]) -> Array:
    """Steps with a shifted Hessian where it is not positive definite."""
    b, t = np.nonzero(~positive)
    values, vectors = eigen(here.hessian[b, :, t][:, LINE])
    size = np.abs(values).max(axis=1, keepdims=True)
    values = np.maximum(np.abs(values), 1e-3 * size)
    g = here.gradient[b, :, t]
    turned = np.einsum("nij,ni->nj", vectors, g) / values
    out = step.copy()
    out[b, :, t] = -np.einsum("nij,nj->ni", vectors, turned)
    return out
