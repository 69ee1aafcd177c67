"""The array's likelihood and its positions, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.errors import Undetermined
from imucalib.estimators.array.likelihood import ArrayPosterior, conditionals
from imucalib.estimators.array.problem import ArrayData, ArrayPrior, MotionPrior
from imucalib.estimators.array.rates import local, modes
from imucalib.estimators.array.sampler import (
    gaussian_positions,
    refuse_collapse,
)
from worlds.array import corners, data_of, skew


def test_independent_draws_have_the_covariance_of_the_fit() -> None:
    rng = np.random.default_rng(0)
    data, _ = data_of(corners(4), 5, rng)
    own = (corners(4)[1:] - corners(4)[0]).ravel()
    root = 1e-5 * rng.normal(size=(9, 9))
    covariance = root @ root.T
    found = gaussian_positions(data, ArrayPrior(corners(4)), 1.002 * own, covariance, rng)
    white = np.linalg.solve(np.linalg.cholesky(covariance), (found.free - 1.002 * own).T)
    assert found.free.shape == (2000, 9)
    np.testing.assert_allclose(np.cov(white), np.eye(9), atol=0.12)
    assert np.abs(white.mean(axis=1)).max() < 0.12
    np.testing.assert_allclose(found.covariance, np.cov(found.free.T))
    np.testing.assert_allclose(found.sd[1:].ravel(), found.free.std(axis=0), rtol=1e-3)
    assert not found.mean[0].any()
    scale, sd = found.scale
    assert scale == pytest.approx(1.002, abs=4.0 * sd)
    assert sd == pytest.approx(np.sqrt(own @ covariance @ own) / (own @ own), rel=0.07)
    assert found.noise == pytest.approx(np.sqrt(np.mean(data.sigma**2)))


def test_a_geometry_that_collapses_or_stays_open_is_refused() -> None:
    """Half of the drawing along one direction; a size beyond 5 %, or a position beyond half of what
    was believed of it before."""
    drawing = 0.02 * np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)], dtype=float)
    refuse_collapse(0.51 * drawing + 0.5, drawing)  # flat as it is drawn, elsewhere
    with pytest.raises(Undetermined, match="along one direction 49 %"):
        refuse_collapse(drawing * [1.0, 0.49, 1.0], drawing)
    rng = np.random.default_rng(1)
    data, _ = data_of(corners(4), 5, rng)
    own = (corners(4)[1:] - corners(4)[0]).ravel()
    along = np.outer(own, own) / (own @ own)
    for sd, of in ((0.06 * np.linalg.norm(own), along), (1.7e-3, np.eye(9) - along)):
        with pytest.raises(Undetermined, match="too little rotation"):
            gaussian_positions(
                data, ArrayPrior(corners(4)), own, sd**2 * of + 1e-14 * np.eye(9), rng
            )


def posterior_of(
    data: ArrayData, motion: MotionPrior = "learned", exponent: float = 0.5, *, noise: bool = False
) -> ArrayPosterior:
    prior = ArrayPrior(
        corners(data.triads), motion=motion, exponent=exponent, motion_scale=3.7e5,
        estimate_noise=noise,
    )  # fmt: skip
    return ArrayPosterior(data, prior, np.ascontiguousarray(data.rate.T))


def log_density(y: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> float:
    off = y - mean
    return float(
        -0.5 * off @ np.linalg.solve(covariance, off)
        - 0.5 * np.linalg.slogdet(2.0 * np.pi * covariance)[1]
    )


@pytest.mark.parametrize("noise", [False, True])
def test_learned_motion_equals_the_joint_gaussian_given_the_rate(noise: bool) -> None:
    """-f(ω) and the constants are log N(y; Ω²r, Q + HΣHᵀ + β 11ᵀ) N(g; ω, P^-1), β large."""
    rng = np.random.default_rng(3)
    data, w = data_of(corners(), 4, rng, sigma=0.5, sigma_gyro=20.0, per_sample=True)
    posterior = posterior_of(data, noise=noise)
    prior, beta = posterior.prior, 1e7
    values = []
    for shift in (0.0, 0.4):
        x = prior.mean_vector + shift * np.minimum(prior.sd_vector, 1e-3 + 0.2 * shift)
        r = prior.geometry(x[None])[0]
        given, geometry = conditionals(data, prior, x[None])
        inner = -local(given, w.T[None]).value[0].sum()
        spin = np.linalg.inv(geometry.factor[0] @ geometry.factor[0].T)
        sigma = data.sigma * np.exp(x[-1] if noise else 0.0)
        h = np.concatenate([-skew(r), np.broadcast_to(np.eye(3), (len(r), 3, 3))], axis=2)
        h = h.reshape(-1, 6)
        cov = np.diag(np.repeat(sigma**2, 3))
        cov += h @ np.block([[spin, np.zeros((3, 3))], [np.zeros((3, 3)), beta * np.eye(3)]]) @ h.T
        turn = skew(w) @ skew(w)
        direct = sum(
            log_density(data.acceleration[t].ravel(), (r @ turn[t].T).ravel(), cov)
            + log_density(data.rate[t], w[t], np.linalg.inv(data.rate_precision[t]))
            for t in range(data.samples)
        )
        # f misses the constants that `value` adds around the Laplace integral of ω.
        at = posterior.value(x[None])[0]
        laplace = _laplace(posterior, x)
        off = (x - prior.mean_vector) / prior.sd_vector
        values.append(at + 0.5 * off @ off - laplace + inner - direct)
    # The flat s leaves one constant, (2πβ)^(3T/2) and the 2π of ω; it must not depend on x.
    assert values[0] == pytest.approx(values[1], abs=2e-3)


def _laplace(posterior: ArrayPosterior, x: np.ndarray) -> float:
    given, _ = conditionals(posterior.data, posterior.prior, x[None])
    here = modes(given, posterior.start).here
    h = here.hessian[0].transpose(2, 0, 1)
    return float(-here.value.sum() - 0.5 * np.linalg.slogdet(h)[1].sum())


@pytest.mark.parametrize(("exponent", "agrees"), [(0.5, True), (1.0, False)])
def test_flat_motion_is_the_limit_with_a_square_root(exponent: float, agrees: bool) -> None:
    """With N(0, β) on ω̇ and s and β large, only |HᵀLH|^-1/2 is right."""
    rng = np.random.default_rng(4)
    data, w = data_of(corners(), 1, rng, sigma=0.5)
    posterior = posterior_of(data, "flat", exponent)
    prior = posterior.prior
    beta = 1e10
    differences = []
    for x in (prior.mean_vector, 1.3 * prior.mean_vector):
        r = prior.geometry(x[None])[0]
        h = np.concatenate([-skew(r), np.broadcast_to(np.eye(3), (len(r), 3, 3))], axis=2)
        h = h.reshape(-1, 6)
        cov = np.diag(np.repeat(data.sigma**2, 3)) + beta * h @ h.T
        mean = (r @ (skew(w[0]) @ skew(w[0])).T).ravel()
        given, geometry = conditionals(data, prior, x[None])
        ours = -local(given, w.T[None]).value[0].sum() - exponent * geometry.log_inertia[0]
        direct = log_density(data.acceleration[0].ravel(), mean, cov)
        differences.append(ours - direct)
    close = abs(differences[0] - differences[1]) < 1e-3
    assert close == agrees


@pytest.mark.parametrize("motion", ["learned", "flat"])
@pytest.mark.parametrize("noise", [False, True])
@pytest.mark.parametrize(("sigma", "gyro"), [(0.04, 0.06), (0.79, 30.0)])
def test_gradient(motion: MotionPrior, noise: bool, sigma: float, gyro: float) -> None:
    rng = np.random.default_rng(5)
    data, _ = data_of(corners(), 6, rng, sigma=sigma, sigma_gyro=gyro, per_sample=True)
    posterior = posterior_of(data, motion, noise=noise)
    prior = posterior.prior
    x = prior.mean_vector + 0.05 * rng.normal(size=prior.size) * prior.sd_vector
    step = 1e-4 * np.diag(prior.sd_vector)
    ends = posterior.value(np.concatenate([x + step, x - step]))
    numeric = (ends[: prior.size] - ends[prior.size :]) / 2e-4
    analytic = posterior.value_and_gradient(x[None])[1][0] * prior.sd_vector
    assert analytic == pytest.approx(numeric, abs=1e-3 + 1e-6 * np.abs(numeric).max())
