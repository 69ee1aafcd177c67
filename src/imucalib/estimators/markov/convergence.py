"""Whether Markov chains can be believed: R-hat, effective sample sizes, Monte Carlo errors.

Vehtari, Gelman, Simpson, Carpenter, Bürkner: Rank-normalization, folding, and localization: an
improved R-hat for assessing convergence of MCMC, Bayesian Analysis 16 (2021), with Geyer's
initial monotone sequence. Draws are (chains, draws, quantities) throughout.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array


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


def autocorrelation(chain: Array) -> Array:
    """(n, d) autocorrelation of one chain (n, d)."""
    covariance = _autocovariance(chain[None])[0]
    return np.asarray(covariance / np.maximum(covariance[:1], 1e-300))


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
