"""Evidence for what a model lacks: a score test of many candidates at once, without a refit.

Each candidate is a block of columns with a Gaussian prior of its physical size, times a factor τ:

    V → V + τ² G Gᵀ,   evidence = max over τ and noise of log p(data | with) - log p(data | without)

by restricted likelihood, with the noise factor profiled in closed form and the settings' variance
components profiled on a grid: a candidate that explains what looked like setting errors gets its
due. The chance that the best of all candidates does as well on data that lack nothing is found
by simulating such data through the same computation (Westfall and Young 1993, minimum p).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from imucalib.balance import whitener
from imucalib.evidence_gram import gram_evidence
from imucalib.fit import Fit

Array = NDArray[np.float64]
Kind = Literal["effect", "probe", "noise", "record"]

#: Simulated data sets of the first look; its floor, 1/300, is below every alpha in use.
_FIRST_DRAWS = 299
_TAU = np.array([0.1, 0.3, 1.0, 3.0, 10.0])
#: Variance components are re-estimated on this grid of factors of the fitted ratio. The fitted
#: ratio itself is left out: the data would sit on a grid point and simulated data beside one.
_SHRINK = (0.0, 0.15, 0.4, 0.72, 0.92, 1.15, 1.6)
#: A block that keeps less than this share of its columns is absorbed by the fitted parameters.
_ABSORBED = 1e-5
#: Independent observations from which on the candidates' Gram matrix stands in for the data.
_MANY = 300


@dataclass(frozen=True)
class Candidate:
    """One block. columns : (N, m) in the balance's units, scaled by the typical size.

    family : the scan that it is one value of, or empty
    """

    name: str
    kind: Kind
    columns: Array
    driver: str = ""
    family: str = ""


@dataclass(frozen=True)
class Score:
    """What the data say of one candidate.

    evidence : nats in favour; p : family-wise, for the best of all candidates, from `draws`
        simulated data sets (no smaller than 1 / (draws + 1))
    left : share of the candidate's columns that the fitted parameters do not absorb (0..1)
    strength : λ, the length of its projected columns at typical size, in noise units: 4.7 gives
        an 80 % chance of detection
    share : of the weighted residual power that it explains, adjusted for its freedom (0..1)
    """

    candidate: Candidate
    evidence: float
    p: float
    draws: int
    left: float
    strength: float
    share: float

    @property
    def name(self) -> str:
        return self.candidate.name

    @property
    def absorbed(self) -> bool:
        return self.left < _ABSORBED


@dataclass(frozen=True)
class _Point:
    """One noise hypothesis: directions (N, M) of all candidates after projection, their squared
    sizes, and the part of the log likelihood that no candidate changes."""

    white: Array
    basis: Array
    u: Array
    size: Array
    constant: float


def score(
    fit: Fit,
    candidates: tuple[Candidate, ...],
    rng: np.random.Generator,
    *,
    draws: int = 1000,
    alpha: float = 0.05,
) -> tuple[Score, ...]:
    """Score candidates against a fit, best first; p by up to `draws` simulated data sets.

    A first part of the draws settles what is clear; only a best p that is neither far above
    `alpha` nor at the first part's floor is worth the rest.
    """
    few = min(draws, _FIRST_DRAWS)
    scores = _score(fit, candidates, rng, few)
    if scores and few < draws and 1.5 / (few + 1) < min(s.p for s in scores) < 4.0 * alpha:
        return _score(fit, candidates, rng, draws)
    return scores


def _score(
    fit: Fit, candidates: tuple[Candidate, ...], rng: np.random.Generator, draws: int
) -> tuple[Score, ...]:
    if not candidates:
        return ()
    if not fit.at.settings and fit.at.residual.size >= _MANY:
        return _score_many(fit, candidates, rng, draws)
    at, noise = fit.at, fit.noise
    fitted = tuple(sd / noise.factor for sd in noise.sd)
    alone = [_alone(fit, c, fitted) for c in candidates]
    live = [k for k, (left, _, _) in enumerate(alone) if left >= _ABSORBED]
    evidence = np.zeros(len(candidates))
    p = np.ones(len(candidates))
    if live:
        blocks = [candidates[k].columns / noise.factor for k in live]
        starts = np.cumsum([0] + [b.shape[1] for b in blocks])[:-1]
        everything = np.column_stack(blocks)
        simulated = _null_data(fit, rng, draws)
        data = np.column_stack([at.residual / noise.factor, simulated])
        found = _evidence(fit, fitted, everything, starts, data)
        best = found[:, 1:].max(axis=0)
        evidence[live] = found[:, 0]
        p[live] = (1 + (best[None] >= found[:, :1]).sum(axis=1)) / (draws + 1)
    scores = [
        Score(c, float(e), float(q), draws, *numbers)
        for c, e, q, numbers in zip(candidates, evidence, p, alone, strict=True)
    ]
    return tuple(sorted(scores, key=lambda s: -s.evidence))


def _score_many(
    fit: Fit, candidates: tuple[Candidate, ...], rng: np.random.Generator, draws: int
) -> tuple[Score, ...]:
    """The same without settings: all by Gram matrices, nothing of the size of the data squared."""
    factor, live = fit.noise.factor, [k for k, c in enumerate(candidates) if np.any(c.columns)]
    blocks = [candidates[k].columns / factor for k in live]
    found = gram_evidence(fit.at.residual / factor, fit.at.jacobian, blocks, _TAU, rng, draws)
    # Scores outlive the search: thousands of numbers a column would stay with them.
    bare = [replace(c, columns=c.columns[:0].copy()) for c in candidates]
    dead = [k for k in range(len(candidates)) if k not in live]
    scores = [Score(bare[k], 0.0, 1.0, draws, 0.0, 0.0, 0.0) for k in dead]
    for i, k in enumerate(live):
        absorbed = found.left[i] < _ABSORBED
        value = 0.0 if absorbed else float(found.evidence[i])
        p = 1.0 if absorbed else (1 + int((found.best >= value).sum())) / (draws + 1)
        numbers = map(float, (found.left[i], found.strength[i], found.share[i]))
        scores.append(Score(bare[k], value, p, draws, *numbers))
    return tuple(sorted(scores, key=lambda s: -s.evidence))


def _alone(fit: Fit, candidate: Candidate, ratio: tuple[float, ...]) -> tuple[float, float, float]:
    """What the fitted parameters leave of a candidate, its λ, and the share that it explains."""
    white = whitener(fit.at.settings, ratio)
    basis = np.linalg.qr(white(fit.at.jacobian))[0]
    columns = white(candidate.columns)
    rest = columns - basis @ (basis.T @ columns)
    whole, kept = float(np.sum(columns**2)), float(np.sum(rest**2))
    left = kept / whole if whole > 0.0 else 0.0
    if left < _ABSORBED:
        return left, 0.0, 0.0
    residual = white(fit.at.residual)
    residual = residual - basis @ (basis.T @ residual)
    u, s, _ = np.linalg.svd(rest, full_matrices=False)
    u = u[:, s > 1e-9 * s[0]]
    freedom = residual.size - basis.shape[1]
    power = max(float(residual @ residual), 1e-300)
    unexplained = 1.0 - float(np.sum((u.T @ residual) ** 2)) / power
    share = 1.0 - unexplained * freedom / max(freedom - u.shape[1], 1)
    return left, float(np.sqrt(kept)) / fit.noise.factor, max(share, 0.0)


def _null_data(fit: Fit, rng: np.random.Generator, draws: int) -> Array:
    """(N, draws) data sets that lack nothing, in units of the fitted noise factor."""
    at = fit.at
    data = rng.standard_normal((at.residual.size, draws))
    for matrix, sd in zip(at.settings, fit.noise.sd, strict=True):
        data += (sd / fit.noise.factor) * matrix @ rng.standard_normal((matrix.shape[1], draws))
    return data


def _evidence(
    fit: Fit, fitted: tuple[float, ...], columns: Array, starts: NDArray[np.intp], data: Array
) -> Array:
    """(candidates, data sets) evidence, the maximum over the noise grid and τ."""
    grids = [tuple(shrink * ratio for shrink in _SHRINK) for ratio in fitted]
    nothing: Array = np.full(data.shape[1], -np.inf)
    best: Array = np.full((len(starts), data.shape[1]), -np.inf)
    for ratio in product(*grids):
        point = _at_point(fit, ratio, columns, starts)
        whitened = whitener(fit.at.settings, ratio)(data)
        whitened -= point.basis @ (point.basis.T @ whitened)
        power = np.sum(whitened**2, axis=0)
        freedom = data.shape[0] - point.basis.shape[1]
        base = point.constant - 0.5 * freedom * np.log(power)
        np.maximum(nothing, base, out=nothing)
        explained = (point.u.T @ whitened) ** 2
        for tau in _TAU:
            gain = tau**2 * point.size
            share = (gain / (1.0 + gain))[:, None]
            drop = np.add.reduceat(share * explained, starts, axis=0)
            penalty = np.add.reduceat(np.log1p(gain), starts)[:, None]
            rest = np.maximum(power - drop, 1e-300)
            value = point.constant - 0.5 * (freedom * np.log(rest) + penalty)
            np.maximum(best, value, out=best)
    return best - nothing


def _at_point(
    fit: Fit, ratio: tuple[float, ...], columns: Array, starts: NDArray[np.intp]
) -> _Point:
    white = whitener(fit.at.settings, ratio)
    basis, triangle = np.linalg.qr(white(fit.at.jacobian))
    projected = white(columns)
    projected = projected - basis @ (basis.T @ projected)
    u, size = projected.copy(), np.zeros(columns.shape[1])
    for first, last in zip(starts, [*starts[1:], columns.shape[1]], strict=True):
        block = projected[:, first:last]
        if last - first == 1:
            size[first] = float(block[:, 0] @ block[:, 0])
            u[:, first] = block[:, 0] / np.sqrt(max(size[first], 1e-300))
            continue
        # Eigenvectors of the small Gram matrix are the block's singular directions.
        values, vectors = np.linalg.eigh(block.T @ block)
        size[first:last] = np.maximum(values, 0.0)
        u[:, first:last] = block @ vectors / np.sqrt(np.maximum(values, 1e-300))
        u[:, first:last][:, values <= 1e-12 * values[-1]] = 0.0
    log_j = float(np.log(np.maximum(np.abs(np.diag(triangle)), 1e-300)).sum())
    return _Point(projected, basis, u, size, -0.5 * white.log_det - log_j)


def collinearity(fit: Fit, one: Candidate, other: Candidate) -> float:
    """Largest cosine between two candidates after projection: 1 means that they are aliases."""
    white = whitener(fit.at.settings, tuple(sd / fit.noise.factor for sd in fit.noise.sd))
    basis = np.linalg.qr(white(fit.at.jacobian))[0]

    def span(columns: Array) -> Array:
        rest = white(columns)
        rest = rest - basis @ (basis.T @ rest)
        u, s, _ = np.linalg.svd(rest, full_matrices=False)
        return u[:, s > 1e-9 * max(float(s[0]), 1e-300)]

    a, b = span(one.columns), span(other.columns)
    if not a.size or not b.size:
        return 0.0
    return float(np.linalg.svd(a.T @ b, compute_uv=False)[0])
