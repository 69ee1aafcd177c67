"""Noise of a worn sensor: independent scatter and a slow walk of the bias, seen by the posture.

    cov n = s² [diag(d) + ρ H K_τ H'],  K_τ(t, t') = exp(-|t - t'| / τ)

Each column of H (n, q) is the share of one independent Ornstein-Uhlenbeck walk in a reading. The
walk begins anew in every part of the data, so that parts which are left out together take nothing
of it with them and all sums over parts are exact. An Ornstein-Uhlenbeck walk is Markov: Kalman's
filter gives L⁻¹ of the Cholesky factor at a cost linear in n (Kalman 1960; Harvey 1989, 3.4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from imucalib.arrays import Array, Index

#: Numbers of the states of some walks that are held at once.
_CACHED = 50_000


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
    """What the filter does to any column: keep (walks, n) of the state from the row before; gain
    (walks, n, q) by which a row moves it; root : (walks, n) √ of a row's variance given those
    before; log_det : (walks, parts)"""

    keep: Array
    gain: Array
    root: Array
    log_det: Array


def whitened(course: Course, walks: Sequence[Walk], columns: Array) -> tuple[Array, Array]:
    """L⁻¹ columns, (walks, n, m) for columns (n, m) in their own precision, and log|V| of every
    part, (walks, parts). As many walks at once as leave their states in the cache."""
    steps = _filter(course, tuple(walks))
    start, longest, length = _order(course)
    counts = (length[:, None] > np.arange(int(length.max()))).sum(axis=0)
    rows = [start[longest[:count]] + step for step, count in enumerate(counts)]
    (n, m), q = columns.shape, course.seen.shape[1]
    out = np.empty((len(walks), n, m), columns.dtype)
    seen = course.seen.astype(columns.dtype)[:, None]
    each = max(1, _CACHED // (course.parts * q * m))
    for a in range(0, len(walks), each):
        some = slice(a, a + each)
        if not any(walk.rho for walk in walks[some]):
            out[some] = columns
            continue
        keep, gain = (x[some].astype(columns.dtype) for x in (steps.keep, steps.gain))
        state = np.zeros((len(keep), course.parts, q, m), columns.dtype)
        for step, at in enumerate(rows):
            state = state[:, : at.size]
            if step:
                state *= keep[:, at, None, None]
            new = columns[at] - (seen[at] @ state)[:, :, 0]
            state += gain[:, at, :, None] * new[:, :, None]
            out[some, at] = new
    out /= steps.root[..., None]
    return out, steps.log_det


def _order(course: Course) -> tuple[Index, Index, Index]:
    """Where each part starts, the parts with the longest first, and their lengths."""
    start = np.searchsorted(course.part, np.arange(course.parts))
    length = np.diff([*start, course.part.size])
    return start.astype(np.intp), np.argsort(-length, kind="stable"), length


def _filter(course: Course, walks: tuple[Walk, ...]) -> _Filter:
    """Made once for a course and its walks: no column enters it."""
    if walks in course.filters:
        return course.filters[walks]
    rho, tau = (np.array([getattr(w, name) for w in walks]) for name in ("rho", "tau"))
    start, longest, length = _order(course)
    n, q = course.seen.shape
    keep, root = np.ones((rho.size, n)), np.empty((rho.size, n))
    gains = np.empty((rho.size, n, q))
    fresh = rho[:, None, None, None] * np.eye(q)
    spread = np.broadcast_to(fresh, (rho.size, course.parts, q, q))
    for step in range(int(length.max())):
        alive = longest[: int((length > step).sum())]
        rows = start[alive] + step
        spread = spread[:, : alive.size]
        if step:
            part = np.exp(-(course.time[rows] - course.time[rows - 1]) / tau[:, None])
            keep[:, rows], kept = part, part[..., None, None] ** 2
            spread = spread * kept + (1.0 - kept) * fresh
        h = course.seen[rows]
        across = (spread @ h[..., None])[..., 0]
        size = np.sum(across * h, axis=-1) + course.variance[rows]
        gain = across / size[..., None]
        spread = spread - gain[..., None] * across[:, :, None]
        gains[:, rows], root[:, rows] = gain, np.sqrt(size)
    log_det = 2.0 * np.add.reduceat(np.log(root), start, axis=1)
    return course.filters.setdefault(walks, _Filter(keep, gains, root, log_det))


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
