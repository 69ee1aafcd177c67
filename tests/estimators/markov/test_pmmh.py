"""Algorithm 1's walk on a likelihood that is known: its answer, its tuning, its burn-in."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.estimators.markov import pmmh

Array = NDArray[np.float64]
MEAN, SD = np.array([1.0, -2.0]), np.array([0.5, 2.0])
SEEN, NOISE = np.array([2.0, 1.0]), np.array([0.25, 3.0])


@dataclass(frozen=True)
class Normal:
    """Data SEEN of noise NOISE; estimates of the likelihood scatter as the algorithm allows."""

    scatter: float = 0.0
    count: int = 7

    @property
    def prior(self) -> SimpleNamespace:
        return SimpleNamespace(mean_vector=MEAN, sd_vector=SD, size=2)

    def log(self, x: Array, rng: np.random.Generator) -> Array:
        exact = -0.5 * np.sum(((x - SEEN) / NOISE) ** 2, axis=1)
        # Unbiased: the mean of the estimate itself, not of its logarithm, is exact.
        return exact + self.scatter * rng.standard_normal(len(x)) - 0.5 * self.scatter**2


WEIGHT = 1.0 / SD**2 + 1.0 / NOISE**2
POSTERIOR = (MEAN / SD**2 + SEEN / NOISE**2) / WEIGHT, WEIGHT**-0.5


def test_the_run_keeps_every_draw_after_the_burn_in(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pmmh, "_TUNING", 50)
    monkeypatch.setattr(pmmh, "tuned_count", lambda data, prior, rng: (Normal(0.2), 0.04))
    prior = SimpleNamespace(size=2)
    found = pmmh.run_pmmh(None, prior, np.random.default_rng(3), iterations=1500, chains=4)  # type: ignore[arg-type]
    assert found.draws.shape == (4, 1500, 2)
    assert found.log_density.shape == (4, 1500)
    assert (found.monte_carlo, found.variance) == (7, 0.04)
    moved = np.any(np.diff(found.draws, axis=1) != 0.0, axis=2)
    assert found.accepted == pytest.approx(moved.mean(), abs=2.0 / 1500)
    # A draw that was not moved keeps its estimate.
    assert not np.any(np.diff(found.log_density, axis=1)[~moved])
    z = (found.draws.mean(axis=(0, 1)) - POSTERIOR[0]) / POSTERIOR[1]
    assert np.abs(z).max() < 0.3
