"""One IMU that is noisier in motion than the others, by the likelihood ratio of its variance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from imucalib.calibrators.array.loop.noise_tests import _each
from imucalib.estimators.array.noise import SensorNoise, Squares

IMUS = ("a", "b", "c", "d")


def test_its_evidence_is_the_likelihood_ratio() -> None:
    """All numbers of the IMU at its own scatter, over the same at that of the others."""
    sigma, rng = 0.1, np.random.default_rng(0)
    values = sigma * rng.standard_normal((300, 4, 3)) * np.array([1.0, 1.0, 2.0, 1.0])[:, None]
    square = Squares(np.sum(values**2, axis=2), np.full(4, 3.0))
    noise = SensorNoise(sigma, 0.0, np.inf, np.ones(4))
    found = _each("gyroscope", square, np.zeros(300), noise, IMUS)
    assert [t.driver for t in found] == list(IMUS)
    for k, test in enumerate(found):
        own = float(np.sqrt(np.mean(values[:, k] ** 2)))
        rest = float(np.sqrt(np.mean(np.delete(values, k, axis=1) ** 2)))
        x = values[:, k].ravel()
        ratio = norm.logpdf(x, scale=own).sum() - norm.logpdf(x, scale=rest).sum()
        assert test.evidence == pytest.approx(ratio if own > rest else 0.0, rel=1e-9, abs=1e-9)
        assert test.strength == pytest.approx(np.sqrt(2.0 * test.evidence))
    assert found[2].evidence > 100.0
