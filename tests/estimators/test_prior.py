"""A fit whose parameters have a prior: its likelihood is the density of the data without them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from imucalib.core.balance import Balanced, Noise
from imucalib.core.prior import Prior, independent
from imucalib.estimators.variance import NoiseEstimate, estimate_with_prior

N, P = 40, 4


def fitted(
    slopes: np.ndarray, values: np.ndarray, mean: np.ndarray, spread: np.ndarray
) -> tuple[NoiseEstimate, np.ndarray]:
    """The linear model's fit and its noise, by turns until each is that of the other; spread :
    (P, P) covariance of the prior."""
    precision, square = np.linalg.inv(spread), 1.0
    prior = Prior(mean, np.linalg.cholesky(precision).T)
    for _ in range(200):
        right = slopes.T @ values / square + precision @ mean
        theta = np.linalg.solve(slopes.T @ slopes / square + precision, right)
        at = Balanced(values - slopes @ theta, slopes, (), (), np.ones((N, 1, 1)), np.arange(N),
                      np.ones((N, 1)))  # fmt: skip
        found = estimate_with_prior(at, Noise(float(np.sqrt(square))), prior, theta)
        square = found.noise.factor**2
    return found, theta


def worlds() -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Slopes, data, and the mean and covariance of a prior whose parameters go together, with noise
    of unlike sizes."""
    rng = np.random.default_rng(5)
    out = []
    for size in (0.3, 1.0, 2.5):
        slopes, root = rng.normal(size=(N, P)), rng.normal(size=(P, P))
        mean = rng.normal(size=P)
        theta = mean + root @ rng.normal(size=P)
        values = slopes @ theta + size * rng.normal(size=N)
        out.append((slopes, values, mean, root @ root.T))
    return out


def test_the_likelihood_is_the_density_with_the_parameters_integrated_out() -> None:
    off = []
    for slopes, values, mean, spread in worlds():
        found, _ = fitted(slopes, values, mean, spread)
        whole = found.noise.factor**2 * np.eye(N) + slopes @ spread @ slopes.T
        density = multivariate_normal(mean=slopes @ mean, cov=whole).logpdf(values)
        off.append(found.log_likelihood - density)
    assert off == pytest.approx([0.5 * N * np.log(2 * np.pi)] * 3, abs=1e-6)


def test_covariance_and_degrees_of_freedom_are_those_of_the_posterior() -> None:
    """A number of data is spent on a parameter as far as they determine it, not its prior."""
    for slopes, values, mean, spread in worlds():
        found, theta = fitted(slopes, values, mean, spread)
        precision = np.linalg.inv(spread)
        posterior = np.linalg.inv(slopes.T @ slopes / found.noise.factor**2 + precision)
        np.testing.assert_allclose(found.covariance, posterior, rtol=1e-6, atol=1e-12)
        assert found.dof == round(N - (P - np.trace(posterior @ precision)))
        assert found.chi2 == pytest.approx(np.sum((values - slopes @ theta) ** 2))


def test_the_prior_of_the_factor_is_worth_four_observations_at_one() -> None:
    """Data that are zero, no parameter spent: (4 + 0) / (4 + n)."""
    at = Balanced(np.zeros(N), np.zeros((N, 1)), (), (), np.ones((N, 1, 1)), np.arange(N),
                  np.ones((N, 1)))  # fmt: skip
    found = estimate_with_prior(at, Noise(1.0), independent(np.zeros(1), np.ones(1)), np.zeros(1))
    assert found.noise.factor**2 == pytest.approx(4.0 / (4.0 + N))


def test_the_slope_of_the_covariance_by_the_noise_is_its_derivative() -> None:
    """By the logarithm of the factor, central differences."""
    slopes, values, mean, spread = worlds()[1]
    found, _ = fitted(slopes, values, mean, spread)

    def posterior(log: float) -> np.ndarray:
        return np.linalg.inv(slopes.T @ slopes / np.exp(2 * log) + np.linalg.inv(spread))

    at, step = np.log(found.noise.factor), 1e-5
    numeric = (posterior(at + step) - posterior(at - step)) / (2 * step)
    np.testing.assert_allclose(found.slope[0], numeric, rtol=1e-6, atol=1e-12)
