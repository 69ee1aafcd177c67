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

    white : (blocks, walks, b, b) L⁻¹ of a block given the rows before; seen : (blocks, walks, b, q)
    L⁻¹ of what the state at the end of the block before does to it; keep : (blocks, walks) of that
    state; gain : (blocks, walks, q, b) by which the white rows move it; log_det : (walks, parts)"""

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
        x[:, some or slice(None)].astype(kind, copy=False)
        for x in (steps.white, steps.seen, steps.keep[..., None, None], steps.gain)
    )
    out: NDArray[Real] = np.empty((inverse.shape[1], n, m), kind)
    state: NDArray[Real] = np.zeros((inverse.shape[1], q, m), kind)
    for k, start in enumerate(range(0, n, _BLOCK)):
        own = columns[start : start + _BLOCK]
        b = len(own)
        white = np.matmul(inverse[k, :, :b, :b], own, out=out[:, start : start + b])
        white -= seen[k, :, :b] @ state
        state = keep[k] * state + gain[k, :, :, :b] @ white
    return out, steps.log_det


def among(course: Course, walks: tuple[Walk, ...], some: Sequence[int]) -> tuple[Walk, ...]:
    """Some of the walks, whose filters are those of all."""
    picked, steps = tuple(walks[k] for k in some), _filter(course, walks)
    at = list(some)
    course.filters[picked] = _Filter(
        steps.white[:, at], steps.seen[:, at], steps.keep[:, at], steps.gain[:, at],
        steps.log_det[at],
    )  # fmt: skip
    return picked


def log_det(course: Course, walks: tuple[Walk, ...]) -> Array:
    """(walks, parts) log|V| of every part."""
    return _filter(course, walks).log_det


def _filter(course: Course, walks: tuple[Walk, ...]) -> _Filter:
    """Made once for a course and its walks: no column enters it.

    A block is b rows, whatever their parts: the state goes on only within a part. Given the rows
    before, the state at their end has the covariance P = ρ + Δ; a row at a later time t of the same
    part sees e = exp(-(t - t') / τ) of it: cov = D + H [ρ K_τ + e e' Δ] H'. Below the rows stands
    the state at the last of them, so that one Cholesky factor holds the gain too.
    """
    if walks in course.filters:
        return course.filters[walks]
    n, q = course.seen.shape
    near, keep = _together(course, walks)
    rows = np.minimum(np.arange(keep[0].size), n - 1).reshape(keep[0].shape)
    real = (np.arange(keep[0].size) < n).reshape(keep[0].shape)
    h = course.seen[rows] * real[..., None]
    variance = np.where(real, course.variance[rows], 1.0)
    whole = np.zeros((len(h), len(walks), _BLOCK + q, _BLOCK + q))
    alike = h @ h.transpose(0, 2, 1)
    np.multiply(near.swapaxes(0, 1), alike[:, None], out=whole[..., :_BLOCK, :_BLOCK])
    whole[..., _BLOCK:, :_BLOCK] = (near[:, :, -1, None] * h.transpose(0, 2, 1)).swapaxes(0, 1)
    diagonal, below = np.arange(_BLOCK), np.arange(_BLOCK, _BLOCK + q)
    whole[..., diagonal, diagonal] += variance[:, None]
    # Of the state itself any number above what the rows tell of it serves.
    whole[..., below, below] = 1.0 + np.array([walk.rho for walk in walks])[:, None]
    sees = np.zeros((len(h), len(walks), _BLOCK + q, q))
    sees[..., :_BLOCK, :] = (keep[..., None] * h).swapaxes(0, 1)
    on = keep[..., -1].T
    sees[..., below, np.arange(q)] = on[..., None]
    off = np.zeros((len(walks), q, q))
    for k, see in enumerate(sees):
        whole[k] = np.linalg.cholesky(whole[k] + see @ off @ see.transpose(0, 2, 1))
        gain = whole[k, :, _BLOCK:, :_BLOCK]
        off = on[k, :, None, None] ** 2 * off - gain @ gain.transpose(0, 2, 1)
        off = 0.5 * (off + off.transpose(0, 2, 1))  # else rounding grows in long recordings
    root = whole[..., diagonal, diagonal].swapaxes(0, 1).reshape(len(walks), -1)[:, :n]
    start = np.searchsorted(course.part, np.arange(course.parts))
    log_det = 2.0 * np.add.reduceat(np.log(root), start, axis=1)
    inverse = _inverse(whole[..., :_BLOCK, :_BLOCK].copy())
    gain = whole[..., _BLOCK:, :_BLOCK].copy()
    found = _Filter(inverse, inverse @ sees[..., :_BLOCK, :], on, gain, log_det)
    return course.filters.setdefault(walks, found)


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
    """Of lower triangles (..., b, b), b a power of two, all at once: of each two neighbours on the
    diagonal, then of blocks of two, four, ... rows."""
    out, b = np.zeros_like(lower), lower.shape[-1]
    diagonal = np.arange(b)
    out[..., diagonal, diagonal] = 1.0 / lower[..., diagonal, diagonal]
    even = diagonal[::2]
    each = out[..., even, even] * out[..., even + 1, even + 1]
    out[..., even + 1, even] = -lower[..., even + 1, even] * each
    size = 2
    while size < b:
        for start in range(0, b, 2 * size):
            above, below = slice(start, start + size), slice(start + size, start + 2 * size)
            across = lower[..., below, above] @ out[..., above, above]
            np.matmul(-out[..., below, below], across, out=out[..., below, above])
        size *= 2
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
    keep = np.exp(-np.diff(course.time, prepend=-np.inf) / walk.tau)
    fresh = np.sqrt(walk.rho * (1.0 - keep**2))
    state = np.zeros((q, draws))
    for start in range(0, n, _BLOCK):
        rows = slice(start, start + _BLOCK)
        own = rng.standard_normal((len(keep[rows]), q, draws)) * fresh[rows, None, None]
        for row, share in enumerate(keep[rows]):
            state = own[row] = own[row] + share * state
        out[rows] += (course.seen[rows, None] @ own)[:, 0]
    return np.asarray(out)
