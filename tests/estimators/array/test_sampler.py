"""Samplers of the array posterior: against each other, resumed, and when they must refuse."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imucalib.errors import NotConverged, Undetermined, UnreadableInput
from imucalib.estimators.array.likelihood import ArrayPosterior
from imucalib.estimators.array.mode import laplace_frame, start_prior
from imucalib.estimators.array.problem import ArrayPrior
from imucalib.estimators.array.sampler import sample_positions
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
