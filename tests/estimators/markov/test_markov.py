"""Chains: their diagnostics by formula, and a sampler that keeps its draws."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.estimators.markov import pmmh
from imucalib.estimators.markov.convergence import (
    convergence,
)


def chains(rho: float, m: int, n: int, d: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    x = np.empty((m, n, d))
    x[:, 0] = rng.standard_normal((m, d))
    for k in range(1, n):
        x[:, k] = rho * x[:, k - 1] + np.sqrt(1 - rho**2) * rng.standard_normal((m, d))
    return x


def test_chains_apart_in_place_or_in_width_are_seen() -> None:
    good = chains(0.0, 4, 400, 1)
    assert convergence(good).rhat[0] < 1.01
    apart = good + np.array([0.0, 0.0, 0.0, 1.0])[:, None, None]
    assert convergence(apart).rhat[0] > 1.05
    wide = good * np.array([1.0, 1.0, 1.0, 3.0])[:, None, None]
    assert convergence(wide).rhat[0] > 1.05
    drifting = good + np.linspace(-1.0, 1.0, 400)[None, :, None]
    assert convergence(drifting).rhat[0] > 1.05


MEAN, SD = np.array([1.0, -2.0]), np.array([0.5, 2.0])
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
        return SimpleNamespace(mean_vector=MEAN, sd_vector=SD, size=2)

    def log_posterior(self, x: Array, rng: np.random.Generator) -> Array:
        exact = -0.5 * np.sum(((x - SEEN) / NOISE) ** 2 + ((x - MEAN) / SD) ** 2, axis=1)
        # Unbiased: the mean of the estimate itself, not of its logarithm, is exact.
        return exact + self.scatter * rng.standard_normal(len(x)) - 0.5 * self.scatter**2


def test_the_run_keeps_every_draw_after_the_burn_in(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pmmh, "_TUNING", 50)
    monkeypatch.setattr(pmmh, "tuned_count", lambda data, prior, rng: (Normal(0.2), 0.04))
    prior = Normal().prior
    found = pmmh.run_pmmh(None, prior, np.random.default_rng(3), iterations=1500, chains=4)  # type: ignore[arg-type]
    assert found.draws.shape == (4, 1500, 2)
    assert (found.monte_carlo, found.variance) == (7, 0.04)
    moved = np.any(np.diff(found.draws, axis=1) != 0.0, axis=2)
    assert found.accepted == pytest.approx(moved.mean(), abs=2.0 / 1500)
    z = (found.draws.mean(axis=(0, 1)) - POSTERIOR[0]) / POSTERIOR[1]
    assert np.abs(z).max() < 0.3
