"""Algorithm 1's walk on a likelihood that is known: its answer, its tuning, its burn-in."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.errors import NotConverged
from imucalib.estimators.markov import pmmh
from imucalib.estimators.markov.pmmh import ACCEPTANCE, _burned_in, _iterate, _level, _start, _Walk

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


def test_the_level_is_likelihood_and_prior() -> None:
    x = np.array([[1.5, 0.0], [3.0, -4.0]])
    due = -0.5 * np.sum(((x - SEEN) / NOISE) ** 2 + ((x - MEAN) / SD) ** 2, axis=1)
    found = _level(Normal(), x, np.random.default_rng(0))  # type: ignore[arg-type]
    np.testing.assert_allclose(found, due)
    begun = _start(Normal(), np.random.default_rng(0), 4000)  # type: ignore[arg-type]
    np.testing.assert_allclose(begun.x.mean(axis=0), MEAN, atol=0.1)
    np.testing.assert_allclose(begun.x.std(axis=0), SD, rtol=0.05)
    np.testing.assert_allclose(begun.level, _level(Normal(), begun.x, np.random.default_rng(0)))  # type: ignore[arg-type]


@pytest.mark.parametrize("scatter", [0.0, 0.3])
def test_the_walk_ends_in_the_posterior_however_the_likelihood_scatters(scatter: float) -> None:
    """A scatter of √0.1 is what N is raised to; the answer does not depend on it."""
    rng, likelihood = np.random.default_rng(1), Normal(scatter)
    x = POSTERIOR[0] + POSTERIOR[1] * rng.standard_normal((3000, 2))
    walk = _Walk(x, _level(likelihood, x, rng), 0.5)  # type: ignore[arg-type]
    accepted = []
    for _ in range(60):
        walk, taken = _iterate(walk, likelihood, rng)  # type: ignore[arg-type]
        accepted.append(taken.mean())
    off = (walk.x.mean(axis=0) - POSTERIOR[0]) / POSTERIOR[1] * 3000**0.5
    assert np.abs(off).max() < 4.0
    np.testing.assert_allclose(walk.x.std(axis=0), POSTERIOR[1], rtol=0.06)
    assert 0.2 < np.mean(accepted) < 0.7
    still = _Walk(walk.x, walk.level + 1e9, 0.5)
    assert np.array_equal(_iterate(still, likelihood, rng)[0].x, walk.x)  # type: ignore[arg-type]


def test_the_burn_in_finds_the_step_and_ends_at_one_level(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pmmh, "_TUNING", 50)
    rng, likelihood = np.random.default_rng(2), Normal(0.2)
    walk, burn_in = _burned_in(_start(likelihood, rng, 8), likelihood, rng, 1000)  # type: ignore[arg-type]
    assert burn_in % 50 == 0
    assert burn_in >= 5 * 50
    taken = []
    for _ in range(200):
        walk, some = _iterate(walk, likelihood, rng)  # type: ignore[arg-type]
        taken.append(some.mean())
    assert 0.5 * ACCEPTANCE[0] < np.mean(taken) < 1.5 * ACCEPTANCE[1]
    # The chains are where the posterior is, wherever they began.
    z = (walk.x - POSTERIOR[0]) / POSTERIOR[1]
    assert np.abs(z).max() < 5.0


def test_chains_that_never_agree_are_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two places that no step joins."""

    @dataclass(frozen=True)
    class Apart(Normal):
        def log(self, x: Array, rng: np.random.Generator) -> Array:
            right = x[:, 0] > 0.0
            return np.where(right, 0.0, -400.0) - 1e7 * (np.abs(x[:, 0]) - 30.0) ** 2

    monkeypatch.setattr(pmmh, "_TUNING", 5)
    x = np.array([[30.0, 0.0], [-30.0, 0.0]])
    rng = np.random.default_rng(0)
    begun = _Walk(x, _level(Apart(), x, rng), 1e-6)  # type: ignore[arg-type]
    with pytest.raises(NotConverged, match="after 500 iterations"):
        _burned_in(begun, Apart(), rng, 10)  # type: ignore[arg-type]


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
