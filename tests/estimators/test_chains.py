"""Chains of a density that is nearly Gaussian, and whether they are believed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import rankdata

from imucalib.arrays import Array
from imucalib.errors import NotConverged
from imucalib.estimators.markov import Stop, convergence, rank_normalised, sample

GRID = np.linspace(-8, 8, 4001)


def tilted(z: Array) -> Array:
    """A skewed density: Gaussian with a tilt that is bounded."""
    return np.asarray(-0.5 * np.sum(z * z, axis=1) + 0.3 * np.sum(np.sin(z), axis=1))


def narrow(z: Array) -> Array:
    """Of a quarter of the width that was thought: independent proposals are mostly refused."""
    return np.asarray(-8.0 * np.sum(z * z, axis=1))


def test_chains_have_the_moments_of_the_density() -> None:
    found = sample(tilted, 3, np.random.default_rng(1), stop=Stop(ess=4000, block=400))
    density = np.exp(-0.5 * GRID**2 + 0.3 * np.sin(GRID))
    mean = np.sum(GRID * density) / density.sum()
    var = np.sum((GRID - mean) ** 2 * density) / density.sum()
    z = (found.draws.mean(axis=(0, 1)) - mean) / found.convergence.mcse
    assert np.abs(z).max() < 4.0
    assert found.draws.var(axis=(0, 1)) == pytest.approx(np.full(3, var), rel=0.1)
    assert found.step == 1.0


def test_the_mean_of_a_gaussian_is_exact_and_all_is_accepted() -> None:
    found = sample(lambda z: -0.5 * np.sum(z * z, axis=1), 5, np.random.default_rng(2))
    assert found.accepted == pytest.approx(1.0)
    assert np.abs(found.draws.mean(axis=(0, 1))).max() < 1e-12


def test_a_wrong_width_takes_shorter_steps_and_is_told_by_the_acceptance() -> None:
    found = sample(narrow, 4, np.random.default_rng(3))
    assert found.step < 1.0
    assert found.draws.std(axis=(0, 1)) == pytest.approx(np.full(4, 0.25), rel=0.2)
    assert found.convergence.bulk.min() >= 400.0


def test_chains_that_are_too_short_are_refused() -> None:
    with pytest.raises(NotConverged, match="after 80 draws"):
        sample(tilted, 2, np.random.default_rng(2), stop=Stop(ess=1e9, most=80))


def chains(rho: float, m: int, n: int, d: int, seed: int = 0) -> Array:
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


def test_ranks_are_those_of_scipy_ties_included() -> None:
    from scipy.special import ndtri

    draws = np.round(chains(0.5, 3, 40, 2), 1)
    flat = draws.reshape(-1, 2)
    want = ndtri((rankdata(flat, axis=0) - 0.375) / (len(flat) + 0.25)).reshape(draws.shape)
    np.testing.assert_allclose(rank_normalised(draws), want, rtol=1e-12)
