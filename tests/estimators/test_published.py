"""Paper 001 as published: its likelihood against the joint Gaussian, and its chain."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.estimators.array import published
from imucalib.estimators.array.published import (
    DrawnPrior,
    MonteCarloLikelihood,
    log_likelihood,
    run_pmmh,
)
from imucalib.estimators.markov import convergence
from worlds.array import corners, data_of, skew


def log_density(y: Array, mean: Array, covariance: Array) -> float:
    off = y - mean
    return float(
        -0.5 * off @ np.linalg.solve(covariance, off)
        - 0.5 * np.linalg.slogdet(2.0 * np.pi * covariance)[1]
    )


@pytest.mark.parametrize("power", [1.0, 2.0])
def test_flat_motion_is_the_limit_with_a_square_root(power: float) -> None:
    """With N(0, β) on dω/dt and s and β large, only |HᵀLH|^-1/2 is right: not twice that."""
    data, w = data_of(corners(), 3, np.random.default_rng(4), sigma=0.5)
    prior, beta, apart = DrawnPrior(corners()), 1e10, []
    for x in (prior.mean, 1.3 * prior.mean):
        r = np.concatenate([np.zeros((1, 3)), x.reshape(-1, 3)])
        h = np.concatenate([-skew(r), np.broadcast_to(np.eye(3), (len(r), 3, 3))], axis=2)
        h = h.reshape(-1, 6)
        cov = np.diag(np.repeat(data.sigma**2, 3)) + beta * h @ h.T
        direct = [
            log_density(
                data.acceleration[t].ravel(), (r @ (skew(w[t]) @ skew(w[t])).T).ravel(), cov
            )
            for t in range(data.samples)
        ]
        root = np.linalg.slogdet((h / np.repeat(data.sigma, 3)[:, None] ** 2).T @ h)[1]
        own = log_likelihood(data, x[None], w[None])[0, 0] - 0.5 * (power - 1.0) * root
        apart.append(own - direct)
    assert (np.abs(apart[0] - apart[1]).max() < 1e-3) == (power == 1.0)


def test_the_monte_carlo_likelihood_averages_over_the_gyros_errors() -> None:
    """Against a grid of rates, of one sample whose gyros err about one axis only."""
    data, _ = data_of(corners(4), 1, np.random.default_rng(3), sigma=0.5, sigma_gyro=2.0)
    sd = np.array([1e-9, 1e-9, 2.0 * np.pi / 180.0])
    data.rate_precision[:] = np.diag(sd**-2.0)
    prior = DrawnPrior(corners(4))
    u = np.linspace(-8.0, 8.0, 4001)
    rate = data.rate + u[:, None, None] * sd * [0.0, 0.0, 1.0]
    density = np.exp(log_likelihood(data, prior.mean[None], rate)[0, :, 0] - 0.5 * u**2)
    exact = np.log(np.sum(density) * (u[1] - u[0]) / np.sqrt(2.0 * np.pi))
    rng, estimate = np.random.default_rng(0), MonteCarloLikelihood(data, prior, 4000)
    values = [estimate.log(prior.mean[None], rng)[0] for _ in range(20)]
    assert np.mean(values) == pytest.approx(exact, abs=5 * np.std(values) / np.sqrt(20) + 0.01)


@pytest.mark.slow
def test_algorithm_one_covers_the_truth() -> None:
    """Four IMUs, as the paper has it: the acceptance, the variance, and z of the truth."""
    rng = np.random.default_rng(5)
    r = np.array([[0, 0, 0], [20, 0, 0], [0, 20, 0], [0, 0, 10.0]]) * 1e-3
    data, _ = data_of(r, 10, rng, sigma=0.79)
    found = run_pmmh(data, DrawnPrior(r), rng, iterations=3000, chains=8)
    assert found.variance <= 0.1
    assert 0.07 <= found.accepted <= 0.23
    assert convergence(found.draws).rhat.max() < 1.1
    z = (found.draws.mean(axis=(0, 1)) - r[1:].ravel()) / found.draws.std(axis=(0, 1))
    assert np.sqrt(np.mean(z * z)) < 2.0


MEAN, SD = np.array([1.0, -2.0]), 2.0
SEEN, NOISE = np.array([2.0, 1.0]), np.array([0.25, 3.0])
WEIGHT = 1.0 / SD**2 + 1.0 / NOISE**2
POSTERIOR = (MEAN / SD**2 + SEEN / NOISE**2) / WEIGHT, WEIGHT**-0.5


@dataclass(frozen=True)
class Normal:
    """Data SEEN of noise NOISE; estimates of the likelihood scatter as the algorithm allows."""

    scatter: float = 0.0
    count: int = 7

    @property
    def prior(self) -> SimpleNamespace:
        return SimpleNamespace(mean=MEAN, sd=SD, size=2)

    def log_posterior(self, x: Array, rng: np.random.Generator) -> Array:
        exact = -0.5 * np.sum(((x - SEEN) / NOISE) ** 2 + ((x - MEAN) / SD) ** 2, axis=1)
        # Unbiased: the mean of the estimate itself, not of its logarithm, is exact.
        return exact + self.scatter * rng.standard_normal(len(x)) - 0.5 * self.scatter**2


def test_the_run_keeps_every_draw_after_the_burn_in(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(published, "_TUNING", 50)
    monkeypatch.setattr(published, "tune_count", lambda data, prior, rng: (Normal(0.2), 0.04))
    prior = Normal().prior
    found = run_pmmh(None, prior, np.random.default_rng(3), iterations=1500, chains=4)  # type: ignore[arg-type]
    assert found.draws.shape == (4, 1500, 2)
    assert (found.monte_carlo, found.variance) == (7, 0.04)
    moved = np.any(np.diff(found.draws, axis=1) != 0.0, axis=2)
    assert found.accepted == pytest.approx(moved.mean(), abs=2.0 / 1500)
    z = (found.draws.mean(axis=(0, 1)) - POSTERIOR[0]) / POSTERIOR[1]
    assert np.abs(z).max() < 0.3
