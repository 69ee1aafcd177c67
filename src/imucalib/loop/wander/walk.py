"""Noise of a worn sensor: independent scatter and a slow walk of the bias, seen by the posture.

    cov n = s² [diag(d) + ρ H K_τ H'],  K_τ(t, t') = exp(-|t - t'| / τ)

Each column of H (n, q) is the share of one independent Ornstein-Uhlenbeck walk in a reading. The
walk begins anew in every part of the data, so that parts which are left out together take nothing
of it with them and all sums over parts are exact. An Ornstein-Uhlenbeck walk is Markov: Kalman's
filter gives L⁻¹ of the Cholesky factor at a cost linear in n (Kalman 1960; Harvey 1989, 3.4), here
for a block of rows at a time, whose own factor is dense.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Index

Real = TypeVar("Real", np.float32, np.float64)

#: Rows that are whitened at once: as many multiplications more a row, in one product of matrices.
_BLOCK = 16


@dataclass(frozen=True)
class Walk:
    """rho : variance of the walk over s²; tau : s, after which it forgets; rho 0 is no walk."""

    rho: float
    tau: float


@dataclass(frozen=True)
class Course:
    """Rows in order of time.

    time : (n,) s; seen : (n, q) H; variance : (n,) d; part : (n,) 0, 1, ... never decreasing, the
        parts in each of which the walk begins anew; filters : those that were made, by their walks
    """

    time: Array
    seen: Array
    variance: Array
    part: Index
    filters: dict[tuple[Walk, ...], _Filter] = field(
        init=False, default_factory=dict, repr=False, compare=False
    )

    @property
    def parts(self) -> int:
        return int(self.part[-1]) + 1


@dataclass(frozen=True)
class _Filter:
    """What the filter does to any column, by blocks of b rows, of which the last may be of nothing.

    white : (walks, blocks, b, b) L⁻¹ of a block given the rows before; seen : (walks, blocks, b, q)
    L⁻¹ of what the state at the end of the block before does to it; keep : (walks, blocks) of that
    state; gain : (walks, blocks, q, b) by which the white rows move it; log_det : (walks, parts)"""

    white: Array
    seen: Array
    keep: Array
    gain: Array
    log_det: Array


def whitened(
    course: Course, walks: Sequence[Walk], columns: NDArray[Real], some: slice | None = None
) -> tuple[NDArray[Real], Array]:
    """L⁻¹ columns, (some, n, m) for columns (n, m) in their own precision under some of the walks,
    all by default, and log|V| of every part, (walks, parts)."""
    steps = _filter(course, tuple(walks))
    (n, m), q, kind = columns.shape, course.seen.shape[1], columns.dtype
    inverse, seen, keep, gain = (
        x[some or slice(None)].astype(kind, copy=False)
        for x in (steps.white, steps.seen, steps.keep[..., None, None], steps.gain)
    )
    out: NDArray[Real] = np.empty((len(inverse), n, m), kind)
    state: NDArray[Real] = np.zeros((len(inverse), q, m), kind)
    for k, start in enumerate(range(0, n, _BLOCK)):
        own = columns[start : start + _BLOCK]
        b = len(own)
        white = np.matmul(inverse[:, k, :b, :b], own, out=out[:, start : start + b])
        white -= seen[:, k, :b] @ state
        state = keep[:, k] * state + gain[:, k, :, :b] @ white
    return out, steps.log_det


def log_det(course: Course, walks: tuple[Walk, ...]) -> Array:
    """(walks, parts) log|V| of every part."""
    return _filter(course, walks).log_det


def _filter(course: Course, walks: tuple[Walk, ...]) -> _Filter:
    """Made once for a course and its walks: no column enters it.

    A block is b rows, whatever their parts: the state goes on only within a part. Given the rows
    before, the state at their end has the covariance P = ρ + Δ; a row at a later time t of the same
    part sees e = exp(-(t - t') / τ) of it: cov = D + H [ρ K_τ + e e' Δ] H'.
    """
    if walks in course.filters:
        return course.filters[walks]
    n, q = course.seen.shape
    near, keep = _together(course, walks)
    rows = np.minimum(np.arange(keep[0].size), n - 1).reshape(keep[0].shape)
    real = (np.arange(keep[0].size) < n).reshape(keep[0].shape)
    h = course.seen[rows] * real[..., None]
    variance = np.where(real, course.variance[rows], 1.0)
    size = near * (h @ h.transpose(0, 2, 1))
    diagonal = np.arange(_BLOCK)
    size[..., diagonal, diagonal] += variance
    seen, on = keep[..., None] * h, keep[..., -1]
    # Of the state at the last row with every row.
    across = near[:, :, -1, None] * h.transpose(0, 2, 1)
    off, lower = np.zeros((len(walks), q, q)), np.empty_like(size)
    for k in range(len(h)):
        known = seen[:, k] @ off
        own = size[:, k] + known @ seen[:, k].transpose(0, 2, 1)
        across[:, k] += on[:, k, None, None] * known.transpose(0, 2, 1)
        lower[:, k] = np.linalg.cholesky(own)
        half = np.linalg.solve(lower[:, k], across[:, k].transpose(0, 2, 1))
        off = on[:, k, None, None] ** 2 * off - half.transpose(0, 2, 1) @ half
        off = 0.5 * (off + off.transpose(0, 2, 1))  # else rounding grows in long recordings
    inverse = _inverse(lower)
    root = lower[..., diagonal, diagonal].reshape(len(walks), -1)[:, :n]
    start = np.searchsorted(course.part, np.arange(course.parts))
    log_det = 2.0 * np.add.reduceat(np.log(root), start, axis=1)
    gain = across @ inverse.transpose(0, 1, 3, 2)
    return course.filters.setdefault(walks, _Filter(inverse, inverse @ seen, on, gain, log_det))


def _together(course: Course, walks: tuple[Walk, ...]) -> tuple[Array, Array]:
    """ρ exp(-|t - t'| / τ) of the rows of every block, (walks, blocks, b, b), and of each row,
    (walks, blocks, b), exp(-(t - t') / τ) to the last one before: nothing between two parts."""
    rho = np.array([walk.rho for walk in walks])
    tau, of = np.unique([walk.tau for walk in walks], return_inverse=True)
    n = len(course.time)
    rows = np.minimum(np.arange(-(-n // _BLOCK) * _BLOCK), n - 1).reshape(-1, _BLOCK)
    time, part, before = course.time[rows], course.part[rows], np.maximum(rows[:, :1] - 1, 0)
    apart = np.abs(time[:, :, None] - time[:, None])
    near = np.exp(-apart / tau[:, None, None, None]) * (part[:, :, None] == part[:, None])
    keep = np.exp(-(time - course.time[before]) / tau[:, None, None])
    keep = keep * (part == course.part[before])
    return rho[:, None, None, None] * near[of], keep[of]


def _inverse(lower: Array) -> Array:
    """Of lower triangles (..., b, b), row by row of all at once: many, and small."""
    out = np.zeros_like(lower)
    unit = 1.0 / np.diagonal(lower, axis1=-2, axis2=-1)
    for i in range(lower.shape[-1]):
        out[..., i, i] = unit[..., i]
        if i:
            above = lower[..., i, None, :i] @ out[..., :i, :i]
            out[..., i, :i] = -above[..., 0, :] * unit[..., i, None]
    return out


def covariance(course: Course, walk: Walk, rows: Index) -> Array:
    """V of some rows of one part, dense: what the filter never makes."""
    time, seen = course.time[rows], course.seen[rows]
    together = np.exp(-np.abs(time[:, None] - time) / walk.tau)
    return np.diag(course.variance[rows]) + walk.rho * (seen @ seen.T) * together


def correlated(course: Course, walk: Walk, columns: Array) -> Array:
    """V columns (n, m) for a walk that goes on through all parts, as `drawn` has it.

    exp(-|t - t'| / τ) times a column is one sum forwards and one backwards in time.
    """
    out = course.variance[:, None] * columns
    if walk.rho == 0.0:
        return np.asarray(out)
    each = course.seen[:, :, None] * columns[:, None]
    keep = np.exp(-np.diff(course.time) / walk.tau)
    before, after = each.copy(), each.copy()
    for row in range(1, len(each)):
        before[row] += keep[row - 1] * before[row - 1]
        after[-row - 1] += keep[-row] * after[-row]
    whole = before + after - each
    return np.asarray(out + walk.rho * np.einsum("nq,nqm->nm", course.seen, whole))


def weighted(course: Course, walk: Walk, columns: Array) -> Array:
    """V⁻¹ columns (n, m), the walk beginning anew in every part."""
    out = np.empty_like(columns)
    for part in range(course.parts):
        rows = np.flatnonzero(course.part == part)
        out[rows] = np.linalg.solve(covariance(course, walk, rows), columns[rows])
    return out


def beside(course: Course, walk: Walk, residual: Array) -> Array:
    """(n,) what is left of a residual when the smoothed walk is taken out: D V⁻¹ r."""
    if walk.rho == 0.0:
        return residual
    left = np.empty_like(residual)
    for part in range(course.parts):
        rows = np.flatnonzero(course.part == part)
        solved = np.linalg.solve(covariance(course, walk, rows), residual[rows])
        left[rows] = course.variance[rows] * solved
    return left


def drawn(course: Course, walk: Walk, rng: np.random.Generator, draws: int) -> Array:
    """(n, draws) noise whose walk goes on through all parts, as it does in a sensor: what
    neighbouring parts share, which the model leaves out, must not pass for an effect."""
    n, q = course.seen.shape
    out = np.sqrt(course.variance)[:, None] * rng.standard_normal((n, draws))
    if walk.rho == 0.0:
        return np.asarray(out)
    root = np.sqrt(walk.rho)
    state = np.zeros((q, draws))
    for row in range(n):
        fresh = root * rng.standard_normal((q, draws))
        if row:
            keep = np.exp(-(course.time[row] - course.time[row - 1]) / walk.tau)
            state = keep * state + np.sqrt(1.0 - keep**2) * fresh
        else:
            state = fresh
        out[row] += course.seen[row] @ state
    return np.asarray(out)
