"""Samplers of the array posterior and the chains they keep: against each other and refusals."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.errors import NotConverged, Undetermined, UnreadableInput
from imucalib.estimators.array.likelihood import ArrayPosterior
from imucalib.estimators.array.mode import laplace_frame, start_prior
from imucalib.estimators.array.problem import ArrayPrior
from imucalib.estimators.array.sampler import sample_positions
from imucalib.estimators.markov import pmmh
from imucalib.estimators.markov.convergence import convergence
from imucalib.estimators.markov.hmc import Stop, sample
from imucalib.estimators.markov.pmmh import MonteCarloLikelihood, run_pmmh
from worlds.array import corners, data_of


def target(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A skewed density: Gaussian with a cubic tilt that is bounded."""
    value = -0.5 * np.sum(z * z, axis=1) + 0.3 * np.sum(np.sin(z), axis=1)
    return value, -z + 0.3 * np.cos(z)


def test_hmc_has_the_targets_moments() -> None:
    found = sample(target, 3, np.random.default_rng(1), stop=Stop(ess=4000, block=200))
    grid = np.linspace(-8, 8, 4001)
    density = np.exp(-0.5 * grid**2 + 0.3 * np.sin(grid))
    mean = np.sum(grid * density) / density.sum()
    var = np.sum((grid - mean) ** 2 * density) / density.sum()
    z = (found.draws.mean(axis=(0, 1)) - mean) / found.convergence.mcse
    assert np.abs(z).max() < 4.0
    assert found.draws.var(axis=(0, 1)) == pytest.approx(np.full(3, var), rel=0.1)


def test_a_resumed_run_is_the_whole_run(tmp_path: Path) -> None:
    whole = sample(target, 2, np.random.default_rng(2), stop=Stop(ess=1000))
    path = tmp_path / "chains.npz"
    with pytest.raises(NotConverged):
        sample(target, 2, np.random.default_rng(2), stop=Stop(ess=1e9, most=100), checkpoint=path)
    rest = sample(target, 2, np.random.default_rng(99), stop=Stop(ess=1000), checkpoint=path)
    assert np.array_equal(rest.draws, whole.draws)
    path.write_bytes(b"no")
    with pytest.raises(UnreadableInput, match="checkpoint"):
        sample(target, 2, np.random.default_rng(2), checkpoint=path)


def test_the_monte_carlo_likelihood_is_the_closed_form() -> None:
    rng = np.random.default_rng(3)
    data, _ = data_of(corners(4), 5, rng, sigma=0.5, sigma_gyro=2.0, per_sample=True)
    prior = ArrayPrior(corners(4), motion="flat")
    x = prior.mean_vector[None]
    exact = ArrayPosterior(data, prior, data.rate.T).value(x)[0]
    estimate = MonteCarloLikelihood(data, prior, 4000)
    values = [estimate.log(x, rng)[0] for _ in range(20)]
    assert np.mean(values) == pytest.approx(exact, abs=5 * np.std(values) / np.sqrt(20) + 0.02)


@pytest.mark.slow
def test_algorithm_one_and_the_fast_sampler_agree() -> None:
    """Four IMUs: means and standard deviations within Monte Carlo error."""
    rng = np.random.default_rng(5)
    r = np.array([[0, 0, 0], [20, 0, 0], [0, 20, 0], [0, 0, 10.0]]) * 1e-3
    data, _ = data_of(r, 10, rng, sigma=0.79)
    prior = ArrayPrior(r, motion="flat")
    fast = sample_positions(data, prior, rng, stop=Stop(ess=3000))
    slow = run_pmmh(data, prior, rng, iterations=3000, chains=32)
    assert slow.variance <= 0.1
    assert 0.07 <= slow.accepted <= 0.23
    checked = convergence(slow.draws)
    assert checked.rhat.max() < 1.05
    sd = fast.free.std(axis=0)
    error = np.sqrt(checked.mcse**2 + fast.convergence.mcse**2)
    z = (slow.draws.mean(axis=(0, 1)) - fast.free.mean(axis=0)) / error
    assert np.sqrt(np.mean(z * z)) < 2.5
    assert slow.draws.std(axis=(0, 1)) == pytest.approx(sd, rel=0.12)


@pytest.mark.parametrize("samples", [5, 50])
def test_positions_are_covered(samples: int) -> None:
    """Truth drawn from the prior: z of the Laplace frame's mean has unit spread over data sets."""
    z = []
    for seed in range(12):
        rng = np.random.default_rng(100 + seed)
        true = corners() + np.vstack([np.zeros(3), rng.normal(size=(7, 3)) * 3e-3])
        data, _ = data_of(true, samples, rng)
        frame = laplace_frame(data, start_prior(data, ArrayPrior(corners())))
        sd = np.sqrt(np.diag(frame.covariance))[:21]
        z.append((frame.mode[:21] - true[1:].ravel()) / sd)
    assert 0.8 < np.std(z) < 1.25


def test_the_flat_priors_collapse_is_refused() -> None:
    """At 100 deg/s the paper's posterior shrinks to a point with perfect R-hat."""
    data, _ = data_of(corners(), 500, np.random.default_rng(7), sigma=0.79, rate=100.0, spin=1000.0)
    prior = ArrayPrior(corners(), motion="flat")
    with pytest.raises((Undetermined, NotConverged)):
        sample_positions(data, prior, np.random.default_rng(0))


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
