"""Noise of chips in motion: the likeliest of a grid, by scipy's densities."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from imucalib.calibrators.array.fused.noise import ChipNoise, at_rest, fitted_noise

T, K = 700, 3


def residuals(
    growth: float, freedom: float, seed: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Residuals (T, K, 3), speeds, noise at rest, and the share that the motion leaves."""
    rng = np.random.default_rng(seed)
    rest, speed = np.array([[0.04] * 3, [0.05] * 3, [0.03] * 3]), rng.uniform(2.0, 15.0, T)
    left = rng.uniform(0.5, 0.9, (T, K))
    sd = np.sqrt(rest**2 + (speed[:, None, None] * growth) ** 2)
    heavy = np.sqrt(freedom / rng.chisquare(freedom, (T, K, 1))) if np.isfinite(freedom) else 1.0
    off = sd * heavy * rng.standard_normal((T, K, 3)) * np.sqrt(left)[..., None]
    return off, speed, rest, left


def density(noise: ChipNoise, off: np.ndarray, speed: np.ndarray, left: np.ndarray) -> float:
    """Of all triads: a multivariate t, or a Gaussian, at residuals over the share left."""
    total = 0.0
    for t in range(0, T, 50):
        for k in range(K):
            variance = noise.rest[k] ** 2 + (speed[t] * noise.growth[k]) ** 2
            x, shape = off[t, k] / np.sqrt(left[t, k]), np.diag(variance)
            whole = (
                stats.multivariate_t(np.zeros(3), shape, df=noise.freedom)
                if np.isfinite(noise.freedom)
                else stats.multivariate_normal(np.zeros(3), shape)
            )
            total += whole.logpdf(x)
    return total


@pytest.mark.parametrize(("growth", "freedom"), [(0.02, 4.0), (0.02, np.inf), (0.005, 6.0)])
def test_the_growth_and_the_tails_come_back(growth: float, freedom: float) -> None:
    off, speed, rest, left = residuals(growth, freedom)
    live = np.ones(off.shape, bool)
    found = fitted_noise(off, live, left, speed, rest)
    assert found.growth == pytest.approx(np.full(K, growth), rel=0.25)
    assert (found.freedom > 20.0) == np.isinf(freedom)
    if np.isfinite(freedom):
        assert 0.6 < found.freedom / freedom < 1.7
    # No less likely than what is true, and more than without growth or with twice the growth.
    best = density(found, off, speed, left)
    assert best > density(ChipNoise(rest, np.full(K, growth), freedom), off, speed, left) - 3.0
    assert best > density(ChipNoise(rest, 2.0 * found.growth, found.freedom), off, speed, left)
    assert best > density(ChipNoise(rest, 0.5 * found.growth, found.freedom), off, speed, left)


def test_noise_that_does_not_grow_is_that_at_rest_and_dead_axes_say_nothing() -> None:
    off, speed, rest, left = residuals(0.0, np.inf)
    live = np.ones(off.shape, bool)
    found = fitted_noise(off, live, left, speed, rest)
    assert found.growth.max() * 10.0 < 0.4 * rest.min()
    off, speed, rest, left = residuals(0.02, np.inf)
    plain = fitted_noise(off, live, left, speed, rest)
    off[:, :, 2], live[:, :, 2] = 1e3, False
    found = fitted_noise(off, live, left, speed, rest)
    assert found.growth == pytest.approx(plain.growth, rel=0.15)


def test_what_a_sample_weighs_and_its_widening() -> None:
    heavy = ChipNoise(np.ones((2, 3)), np.array([0.5, 0.0]), 4.0)
    np.testing.assert_allclose(heavy.variance(np.array([0.0, 4.0])),
                               [[[1.0] * 3, [1.0] * 3], [[5.0] * 3, [1.0] * 3]])  # fmt: skip
    square, live = np.array([[0.0, 3.0]]), np.array([[3.0, 2.0]])
    np.testing.assert_allclose(heavy.share(square, live), [[7.0 / 4.0, 6.0 / 7.0]])
    assert heavy.widening == pytest.approx(9.0 / 7.0)
    assert at_rest(np.ones((2, 3))).widening == 1.0
