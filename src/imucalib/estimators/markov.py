"""Markov chains of a density that is nearly a unit Gaussian, and whether they can be believed.

Preconditioned Crank-Nicolson: a proposal √(1 - β²) z + β ξ leaves the unit Gaussian as it is, so
that it is taken or refused by how far the density departs from that alone; with β = 1 it is
independent Metropolis (Cotter, Roberts, Stuart, White: MCMC methods for functions, Statistical
Science 28 (2013), section 4). Where nearly all are taken, the Gaussian is the density's shape.

Diagnostics: R-hat, effective sample sizes, Monte Carlo errors (Vehtari, Gelman, Simpson, Carpenter,
Bürkner: Rank-normalization, folding, and localization: an improved R-hat for assessing convergence
of MCMC, Bayesian Analysis 16 (2021), with Geyer's initial monotone sequence). Draws are (chains,
draws, quantities) throughout.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import NotConverged

#: (chains, d) in the frame -> log density (chains,), up to a constant
Target = Callable[[Array], Array]
_PAIRS = 2  # of chains
#: Shares β of a proposal that is new, tried in this order, and the acceptance from which one
#: serves: half as many taken cost three times the draws, a β of 0.7 costs as many.
_STEPS, _TAKEN = (1.0, 0.7, 0.5, 0.35, 0.25, 0.15), 0.5


@dataclass(frozen=True)
class Convergence:
    """Per quantity (d,): rank-normalised split R-hat, bulk and tail effective sample sizes, and
    the Monte Carlo standard error of the mean."""

    rhat: Array
    bulk: Array
    tail: Array
    mcse: Array

    def is_reached(self, rhat: float = 1.01, ess: float = 400.0, *, tails: bool = True) -> bool:
        """Whether every quantity meets both limits, the second in the tails too; NaN meets none."""
        enough = np.all(self.bulk >= ess) and (not tails or np.all(self.tail >= ess))
        return bool(np.all(self.rhat < rhat) and enough)

    @property
    def sentence(self) -> str:
        """The worst of each, in words."""
        return (
            f"largest R-hat {np.max(self.rhat):.4f}, smallest effective sample size "
            f"{np.min(self.bulk):.0f} in the bulk and {np.min(self.tail):.0f} in the tails"
        )


def convergence(draws: Array) -> Convergence:
    """All diagnostics of draws (chains, draws, d); at least 8 draws a chain."""
    halves = split(draws)
    folded = np.abs(halves - np.median(halves, axis=(0, 1)))
    ranked = rank_normalised(halves)
    rhat = np.maximum(
        potential_scale_reduction(ranked), potential_scale_reduction(rank_normalised(folded))
    )
    low, high = np.quantile(halves, (0.05, 0.95), axis=(0, 1))
    tails = [effective_size((halves <= q).astype(np.float64)) for q in (low, high)]
    sd = draws.std(axis=(0, 1), ddof=1)
    mcse = sd / np.sqrt(effective_size(halves))
    return Convergence(rhat, effective_size(ranked), np.minimum(*tails), mcse)


def split(draws: Array) -> Array:
    """Each chain as its two halves; the middle draw of an odd number is left out."""
    half = draws.shape[1] // 2
    return np.concatenate([draws[:, :half], draws[:, draws.shape[1] - half :]], axis=0)


def rank_normalised(draws: Array) -> Array:
    """Normal scores of the ranks over all chains, average ranks for ties (eq. 14)."""
    from scipy.special import ndtri

    m, n, d = draws.shape
    ranks = np.empty((m * n, d))
    for k, values in enumerate(draws.reshape(m * n, d).T):
        _, which, count = np.unique(values, return_inverse=True, return_counts=True)
        ranks[:, k] = (np.cumsum(count) - 0.5 * (count - 1))[which]
    return np.asarray(ndtri((ranks - 0.375) / (m * n + 0.25)).reshape(m, n, d))


def potential_scale_reduction(draws: Array) -> Array:
    """(d,) R-hat of chains as they are; NaN for a constant quantity."""
    n = draws.shape[1]
    within = draws.var(axis=1, ddof=1).mean(axis=0)
    between = n * draws.mean(axis=1).var(axis=0, ddof=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.sqrt((between / within + n - 1.0) / n))


def effective_size(draws: Array) -> Array:
    """(d,) effective number of draws; NaN for a constant quantity."""
    m, n, _ = draws.shape
    covariance = _autocovariance(draws)
    within = covariance[:, 0].mean(axis=0) * n / (n - 1.0)
    pooled = within * (n - 1.0) / n
    if m > 1:
        pooled = pooled + draws.mean(axis=1).var(axis=0, ddof=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        rho = 1.0 - (within - covariance.mean(axis=0)) / pooled
    rho[0] = 1.0
    tau = _integrated_time(rho)
    # Antithetic chains can beat independent draws; log10(total) bounds how far that is believed.
    size = m * n / np.maximum(tau, 1.0 / np.log10(m * n))
    return np.where(pooled > 0.0, size, np.nan)


def _autocovariance(draws: Array) -> Array:
    """(m, n, d), biased: divided by n at each lag."""
    from scipy.fft import irfft, next_fast_len, rfft

    n = draws.shape[1]
    size = next_fast_len(2 * n, real=True)
    spectrum = rfft(draws - draws.mean(axis=1, keepdims=True), size, axis=1)
    return np.asarray(irfft(np.abs(spectrum) ** 2, size, axis=1)[:, :n] / n)


def _integrated_time(rho: Array) -> Array:
    """(d,) by Geyer's initial monotone positive sequence of the pair sums ρ_2k + ρ_2k+1."""
    pairs = rho.shape[0] // 2
    sums = rho[: 2 * pairs].reshape(pairs, 2, -1).sum(axis=1)
    last = np.where(np.any(sums <= 0.0, axis=0), np.argmax(sums <= 0.0, axis=0), pairs)
    kept = np.arange(pairs)[:, None] < last
    total = np.where(kept, np.minimum.accumulate(sums, axis=0), 0.0).sum(axis=0)
    edge = rho[np.minimum(2 * last, rho.shape[0] - 1), np.arange(rho.shape[1])]
    return np.asarray(-1.0 + 2.0 * total + np.where(last < pairs, np.maximum(edge, 0.0), 0.0))


@dataclass(frozen=True)
class Stop:
    """When chains are long enough: blocks of `block` draws until R-hat is met and ESS in the bulk,
    which is what a mean needs. R-hat below 1.01 takes many more draws of nearly independent ones
    than ESS does, which counts what lies between chains too."""

    rhat: float = 1.05
    ess: float = 400.0
    block: int = 40
    most: int = 4000


@dataclass(frozen=True)
class Chains:
    """draws : (chains, n, d) in the frame; accepted : mean acceptance; step : β; convergence : of
    what was seen"""

    draws: Array
    accepted: float
    step: float
    convergence: Convergence


def sample(
    target: Target,
    d: int,
    rng: np.random.Generator,
    *,
    stop: Stop | None = None,
    seen: Callable[[Array], Array] = lambda draws: draws,
) -> Chains:
    """Draw until the diagnostics of `seen(draws)`, what will be reported, are met.

    The chains of a pair take opposite proposals, so that the error of one's mean is nearly the
    other's with its sign changed.

    Raises NotConverged with the diagnostics when `stop.most` draws are not enough.
    """
    rule, steps, taken = stop or Stop(), list(_STEPS), 0.0
    z = _opposite(rng, _PAIRS, d)
    level, draws = target(z), np.empty((2 * _PAIRS, 0, d))
    while True:
        z, level, more, share = _block(target, z, level, steps[0], rule.block, rng)
        if share < _TAKEN and len(steps) > 1 and not draws.size:
            del steps[0]
            continue
        draws, taken = np.concatenate([draws, more], axis=1), taken + share * rule.block
        count = draws.shape[1]
        if count < 2 * rule.block:
            continue
        found = convergence(seen(draws))
        if found.is_reached(rule.rhat, rule.ess, tails=False):
            return Chains(draws, taken / count, steps[0], found)
        if count >= rule.most:
            raise NotConverged(
                f"the chains do not agree after {count} draws each: {found.sentence}",
                remedy="too little rotation, or samples that contradict each other: record a "
                "more varied motion, or use more samples",
            )


def _opposite(rng: np.random.Generator, pairs: int, d: int) -> Array:
    """(2 pairs, d) normal numbers, the second half the first's with their signs changed."""
    one = rng.standard_normal((pairs, d))
    return np.concatenate([one, -one])


def _block(
    target: Target, z: Array, level: Array, step: float, count: int, rng: np.random.Generator
) -> tuple[Array, Array, Array, float]:
    """The chains `count` draws on, their levels, those draws, and the share that was taken."""
    chains, d = z.shape
    draws, taken = np.empty((chains, count, d)), 0.0
    white = np.array([_opposite(rng, chains // 2, d) for _ in range(count)])
    # Proposals that hang on no draw are judged all at once.
    ahead = target(white.reshape(-1, d)).reshape(count, chains) if step == 1.0 else None
    for k in range(count):
        there = np.sqrt(1.0 - step**2) * z + step * white[k]
        high = target(there) if ahead is None else ahead[k]
        # What remains of the density when the Gaussian is divided out.
        gain = high - level + 0.5 * np.sum(there**2 - z**2, axis=1)
        moved = np.log(np.tile(rng.random(chains // 2), 2)) < gain
        z, level = np.where(moved[:, None], there, z), np.where(moved, high, level)
        draws[:, k] = z
        taken += float(moved.mean()) / count
    return z, level, draws, taken
