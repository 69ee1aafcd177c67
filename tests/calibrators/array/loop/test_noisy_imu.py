"""One IMU that is noisier in motion than the others, by the likelihood ratio of its variance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from imucalib.calibrators.array.loop.noise_tests import _each
from imucalib.estimators.array.noise import SensorNoise, Squares

IMUS = ("a", "b", "c", "d")


def test_its_evidence_is_the_likelihood_ratio() -> None:
    """The IMU at its own scatter and the others at theirs, over all at one."""
    sigma, rng = 0.1, np.random.default_rng(0)
    values = sigma * rng.standard_normal((300, 4, 3)) * np.array([1.0, 1.0, 2.0, 1.0])[:, None]
    square = Squares(np.sum(values**2, axis=2), np.full(4, 3.0))
    noise = SensorNoise(sigma, 0.0, np.inf, np.ones(4))
    found = _each("gyroscope", square, np.zeros(300), noise, IMUS)
    assert [t.driver for t in found] == list(IMUS)
    for k, test in enumerate(found):
        own = float(np.sqrt(np.mean(values[:, k] ** 2)))
        others = np.delete(values, k, axis=1)
        rest, one = (float(np.sqrt(np.mean(x**2))) for x in (others, values))
        apart = norm.logpdf(values[:, k], scale=own).sum() + norm.logpdf(others, scale=rest).sum()
        ratio = apart - norm.logpdf(values, scale=one).sum()
        assert test.evidence == pytest.approx(ratio if own > rest else 0.0, rel=1e-9, abs=1e-9)
        assert test.strength == pytest.approx(np.sqrt(2.0 * test.evidence))
    assert found[2].evidence > 100.0


def test_noise_that_is_alike_has_what_chance_is_drawn_as() -> None:
    """Twice the nats are half of a χ² of one number: against the others taken as known, they were
    a third more for four IMUs, and alarms of single IMUs nearly three times as many for eight."""
    rng, noise = np.random.default_rng(1), SensorNoise(1.0, 0.0, np.inf, np.ones(4))
    nats = []
    for _ in range(2000):
        square = Squares(np.sum(rng.standard_normal((60, 4, 3)) ** 2, axis=2), np.full(4, 3.0))
        nats.append(_each("gyroscope", square, np.zeros(60), noise, IMUS)[0].evidence)
    # The mean of half of a χ² has the sd sqrt(5/4) here: 0.025 over 2000.
    assert 2.0 * np.mean(nats) == pytest.approx(0.5, abs=0.075)
