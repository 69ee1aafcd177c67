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
from typing import Literal

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.core.fit import Fit
from imucalib.loop.evidence_gram import gram_evidence
from imucalib.loop.noise.grid import EXCESS, HELD, TAU, EvidenceGrid
from imucalib.loop.noise.strength import strengths
from imucalib.loop.thresholds import ABSORBED

Kind = Literal["effect", "probe", "noise", "record"]

#: Simulated data sets are drawn in parts; the second one's floor is below every alpha in use.
_PARTS = (59, 299)
#: Independent observations from which on the candidates' Gram matrix stands in for the data.
_MANY = 300


@dataclass(frozen=True)
class Candidate:
    """One block. columns : (N, m) in the balance's units, scaled by the typical size.

    family : the scan that it is one value of, or empty; curve : of a probe, what could correct it
    (a value of the family "curve", without the number of terms); unfounded : as its family; chance
    is counted among such by themselves, and others pay nothing for them
    """

    name: str
    kind: Kind
    columns: Array
    driver: str = ""
    family: str = ""
    curve: str = ""
    unfounded: bool = False


@dataclass(frozen=True)
class Score:
    """What the data say of one candidate.

    evidence : nats in favour; p : family-wise, for the best of all candidates, from `draws`
        simulated data sets (no smaller than 1 / (draws + 1))
    left : share of the candidate's columns that the fitted parameters do not absorb (0..1)
    strength : λ, the length of its projected columns at typical size, in noise units: 4.7 gives
        an 80 % chance of detection
    share : of the weighted residual power that it explains, adjusted for its freedom (0..1)
    size : m/s², rms of the whole block on an observation: what an absorbed effect of typical size
        does to the answer without a trace in the residual
    bar : evidence that the best of all candidates exceeds by chance in a share alpha of data sets
        that lack nothing (infinite without draws)
    """

    candidate: Candidate
    evidence: float
    p: float
    draws: int
    left: float
    strength: float
    share: float
    size: float = 0.0
    bar: float = np.inf

    @property
    def name(self) -> str:
        return self.candidate.name

    @property
    def absorbed(self) -> bool:
        return self.left < ABSORBED


def score(
    fit: Fit,
    candidates: tuple[Candidate, ...],
    rng: np.random.Generator,
    *,
    draws: int = 1000,
    alpha: float = 0.05,
) -> tuple[Score, ...]:
    """Score candidates against a fit, best first; p by up to `draws` simulated data sets.

    Draws are made in parts: what is clear after a part, far above `alpha` or at the part's floor,
    is not worth the rest.
    """
    if not candidates:
        return ()
    if not fit.at.settings and fit.at.residual.size >= _MANY:
        return _score_many(fit, candidates, rng, draws, alpha)
    return _score_few(fit, candidates, rng, draws, alpha)


def _undecided(p: float, done: int, alpha: float) -> bool:
    """Whether more draws could change which side of alpha p is on."""
    if done < _PARTS[1]:
        return p - 3.0 * float(np.sqrt(p * (1.0 - p) / done)) < alpha
    return p > 1.5 / (done + 1) and abs(p - alpha) < 3.0 * (alpha * (1.0 - alpha) / done) ** 0.5


def _score_few(
    fit: Fit, candidates: tuple[Candidate, ...], rng: np.random.Generator, draws: int, alpha: float
) -> tuple[Score, ...]:
    at, noise = fit.at, fit.noise
    alone = strengths(fit, [c.columns for c in candidates])
    live = np.flatnonzero(alone.live)
    evidence, p = np.zeros(len(candidates)), np.ones(len(candidates))
    chance = _Chance(np.ones(0), {}, 0)
    if live.size:
        grid = EvidenceGrid(
            at.jacobian,
            at.settings,
            noise.ratio,
            [candidates[k].columns / noise.factor for k in live],
            without=fit.observations.walk.without if fit.observations.walk else None,
            parts=[i for i, k in enumerate(live) if candidates[k].kind == "effect"],
            coarse=draws == 0 or any(noise.alone for noise in fit.observations.shared),
            held={
                at.free + k: EXCESS if noise.alone else HELD
                for k, noise in enumerate(fit.observations.shared)
                if not noise.wanders
            },
        )
        found = grid.evidence(at.residual[:, None] / noise.factor)
        apart = np.array([candidates[k].unfounded for k in live])
        chance = _by_chance(fit, grid, found, apart, rng, draws=draws, alpha=alpha)
        evidence[live], p[live] = found[:, 0], chance.p
    scores = [
        Score(
            candidate=c, evidence=float(evidence[k]), p=float(p[k]), draws=chance.draws,
            left=float(alone.left[k]), strength=float(alone.strength[k]),
            share=float(alone.share[k]), size=_size(fit, c),
            bar=_bar(chance.null.get(c.unfounded), alpha),
        )
        for k, c in enumerate(candidates)
    ]  # fmt: skip
    return tuple(sorted(scores, key=lambda s: -s.evidence))


@dataclass(frozen=True)
class _Chance:
    """p : of each candidate; null : (draws,) the best of those that are founded (False), and of
    those that are not (True), on data that lack nothing"""

    p: Array
    null: dict[bool, Array]
    draws: int


def _by_chance(
    fit: Fit, grid: EvidenceGrid, found: Array, apart: Flags, rng: np.random.Generator, *,
    draws: int, alpha: float,
) -> _Chance:  # fmt: skip
    """found : (candidates, 1); apart : which are unfounded; draws : at most"""
    p, done = np.ones(len(found)), 0
    null: dict[bool, Array] = {pool: np.zeros(0) for pool in set(apart.tolist())}
    for part in (*_PARTS, draws):
        size = min(part, draws) - done
        if size <= 0:
            break
        simulated, done = grid.evidence(_null_data(fit, rng, size)), done + size
        for pool, before in null.items():
            own = apart == pool
            best = null[pool] = np.concatenate([before, simulated[own].max(axis=0)])
            p[own] = (1 + (best[None] >= found[own]).sum(axis=1)) / (done + 1)
        if not _undecided(float(p.min()), done, alpha):
            break
    return _Chance(p, null, done)


def _size(fit: Fit, candidate: Candidate) -> float:
    sized = candidate.columns * fit.at.unit[:, None]
    return float(np.linalg.norm(sized) / fit.observations.n**0.5)


def _bar(null: Array | None, alpha: float) -> float:
    return np.inf if null is None or not null.size else float(np.quantile(null, 1.0 - alpha))


def _score_many(
    fit: Fit, candidates: tuple[Candidate, ...], rng: np.random.Generator, draws: int, alpha: float
) -> tuple[Score, ...]:
    """The same without settings: all by Gram matrices, nothing of the size of the data squared."""
    factor, live = fit.noise.factor, [k for k, c in enumerate(candidates) if np.any(c.columns)]
    blocks = [candidates[k].columns for k in live]
    found = gram_evidence(
        fit.at.residual / factor, fit.at.jacobian, blocks, TAU, rng, draws, unit=factor,
        parts=[i for i, k in enumerate(live) if candidates[k].kind == "effect"],
    )  # fmt: skip
    # Scores outlive the search: thousands of numbers a column would stay with them.
    bare = [replace(c, columns=c.columns[:0].copy()) for c in candidates]
    dead = [k for k in range(len(candidates)) if k not in live]
    scores = [
        Score(
            candidate=bare[k], evidence=0.0, p=1.0, draws=draws, left=0.0, strength=0.0, share=0.0
        )
        for k in dead
    ]
    for i, k in enumerate(live):
        absorbed = found.left[i] < ABSORBED
        value = 0.0 if absorbed else float(found.evidence[i])
        p = 1.0 if absorbed else (1 + int((found.best >= value).sum())) / (draws + 1)
        left, strength, share = (float(v[i]) for v in (found.left, found.strength, found.share))
        bar, size = _bar(found.best, alpha), _size(fit, candidates[k])
        told = Score(
            candidate=bare[k], evidence=value, p=p, draws=draws, left=left, strength=strength,
            share=share, size=size, bar=bar,
        )  # fmt: skip
        scores.append(told)
    return tuple(sorted(scores, key=lambda s: -s.evidence))


def _span(columns: Array) -> Array:
    """Orthonormal basis of columns, without directions that are only rounding."""
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    return u[:, s > 1e-9 * max(float(s[0]), 1e-300)]


def _null_data(fit: Fit, rng: np.random.Generator, draws: int) -> Array:
    """(N, draws) data sets that lack nothing, in units of the fitted noise factor."""
    at = fit.at
    data = rng.standard_normal((at.residual.size, draws))
    for matrix, sd in zip(at.settings, fit.noise.sd, strict=True):
        data += (sd / fit.noise.factor) * matrix @ rng.standard_normal((matrix.shape[1], draws))
    return data


def apart(fit: Fit, found: Candidate, rival: Candidate) -> float:
    """λ sin(angle): how much of what a candidate explains a rival cannot, in units of the noise
    that is left beside the candidate: what it explains is no noise.

    Below about 2 nothing in the data tells the two apart, whichever scores higher.
    """
    white, basis = fit.white_basis()

    def projected(columns: Array) -> Array:
        rest = white(columns)
        return rest - basis @ (basis.T @ rest)

    span, other = _span(projected(found.columns)), _span(projected(rival.columns))
    residual = projected(fit.at.residual)
    explained = span @ (span.T @ residual)
    freedom = max(residual.size - basis.shape[1] - span.shape[1], 1)
    noise = float(np.linalg.norm(residual - explained)) / freedom**0.5
    left = explained - other @ (other.T @ explained)
    return float(np.linalg.norm(left) / max(noise, 1e-300))
