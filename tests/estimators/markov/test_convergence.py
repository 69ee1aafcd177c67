"""Convergence diagnostics against their formulas, cases with a known answer, and each other."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.estimators.markov.convergence import (
    convergence,
    effective_size,
    potential_scale_reduction,
    reached,
)


def chains(rho: float, m: int, n: int, d: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    x = np.empty((m, n, d))
    x[:, 0] = rng.standard_normal((m, d))
    for k in range(1, n):
        x[:, k] = rho * x[:, k - 1] + np.sqrt(1 - rho**2) * rng.standard_normal((m, d))
    return x


def test_rhat_is_the_formula() -> None:
    x = chains(0.3, 4, 50, 3)
    m, n = 4, 50
    for k in range(3):
        means = [x[c, :, k].mean() for c in range(m)]
        b = n / (m - 1) * sum((v - np.mean(means)) ** 2 for v in means)
        w = np.mean([((x[c, :, k] - means[c]) ** 2).sum() / (n - 1) for c in range(m)])
        plain = np.sqrt(((n - 1) / n * w + b / n) / w)
        assert potential_scale_reduction(x)[k] == pytest.approx(plain, rel=1e-12)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_size_of_an_autoregression(rho: float) -> None:
    """The integrated time of AR(1) is (1 + ρ) / (1 - ρ)."""
    x = chains(rho, 4, 4000, 20)
    expected = 16000 * (1 - rho) / (1 + rho)
    size = effective_size(x)
    assert size.mean() == pytest.approx(expected, rel=0.08)


def test_chains_apart_in_place_or_in_width_are_seen() -> None:
    good = chains(0.0, 4, 400, 1)
    assert convergence(good).rhat[0] < 1.01
    apart = good + np.array([0.0, 0.0, 0.0, 1.0])[:, None, None]
    assert convergence(apart).rhat[0] > 1.05
    wide = good * np.array([1.0, 1.0, 1.0, 3.0])[:, None, None]
    assert convergence(wide).rhat[0] > 1.05
    drifting = good + np.linspace(-1.0, 1.0, 400)[None, :, None]
    assert convergence(drifting).rhat[0] > 1.05


def test_monte_carlo_error_covers_the_mean() -> None:
    found = [convergence(chains(0.5, 4, 300, 1, seed)) for seed in range(60)]
    means = [chains(0.5, 4, 300, 1, seed).mean() for seed in range(60)]
    z = np.array(means) / np.array([f.mcse[0] for f in found])
    assert 0.75 < z.std() < 1.3


@pytest.mark.parametrize("draws", [40, 400, 4000])
def test_what_is_asked_first_decides_as_all_does(draws: int) -> None:
    x = chains(0.1, 4, draws, 3)
    whole, found = convergence(x), reached(x, 1.01, 400.0)
    assert (found is not None) == whole.reached(1.01, 400.0) == (draws > 40)
    if found is not None:
        assert np.array_equal(found.rhat, whole.rhat)
