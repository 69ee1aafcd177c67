"""The mixed model behind every fit and what is left of a balance, against dense matrices."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import null_space
from scipy.stats import multivariate_normal

from imucalib.arrays import Array
from imucalib.core.balance import Balanced, Noise, balance, setting_errors, whitener
from imucalib.core.fit import Fit
from imucalib.core.restricted import restrict
from imucalib.effects.record_error import record_error
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.estimators.variance import estimate_noise
from imucalib.posterior.held_out import theta_without
from worlds.bench import NINE, base_model, bench, draw, ordinary_theta, tumble


@cache
def _known() -> Fit:
    """24 positions; fives share an inclination setting, so neighbours are correlated."""
    model, data = base_model(), bench(21, 24, shared=True)
    return fit_model(model, draw(model, ordinary_theta(model, data, 22), data, 23))


@cache
def _norm() -> Fit:
    model, data = base_model(NINE), tumble(24, 24)
    known = bench(24, 24)
    theta = ordinary_theta(model, data, 25)
    return fit_model(model, data.set_reading(draw(model, theta, known, 26).reading))


def _dense(at: Balanced, noise: Noise) -> Array:
    """V by its definition, in units of the declared noise."""
    covariance = noise.factor**2 * np.eye(at.residual.size)
    for matrix, sd in zip(at.settings, noise.sd, strict=True):
        covariance += sd**2 * matrix @ matrix.T
    return covariance


def _restricted(at: Balanced, noise: Noise) -> float:
    """REML by its definition: the density of the contrasts that no parameter moves."""
    contrasts = null_space(at.jacobian.T)
    covariance = contrasts.T @ _dense(at, noise) @ contrasts
    return float(multivariate_normal(cov=covariance).logpdf(contrasts.T @ at.residual))


def test_restricted_likelihood_is_the_density_of_contrasts() -> None:
    at, start = _known().at, _known().noise
    base = estimate_noise(at, start, fixed=True).log_likelihood - _restricted(at, start)
    for factor, a, b in product((0.7, 1.5), (0.5, 2.0), (0.0, 1.3)):
        noise = replace(start, factor=factor, sd=(a * start.sd[0], b * start.sd[1]))
        found = estimate_noise(at, noise, fixed=True).log_likelihood
        assert found - _restricted(at, noise) == pytest.approx(base, abs=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_the_noise_found_is_the_most_likely(seed: int) -> None:
    model, data = base_model(), bench(seed, 30, shared=seed % 2 == 0)
    found = fit_model(model, draw(model, ordinary_theta(model, data, 1), data, 50 + seed))
    best = _restricted(found.at, found.noise)
    for scales in product((0.9, 1.0, 1.1), repeat=3):
        sd = tuple(max(s * v, 1e-5) for s, v in zip(scales[1:], found.noise.sd, strict=True))
        other = replace(found.noise, factor=scales[0] * found.noise.factor, sd=sd)
        assert _restricted(found.at, other) <= best + 1e-5
    # Nor is there a better one far away, with a component absent or large.
    for a, b in product((1e-6, 1e-4, 4e-4, 4e-3), repeat=2):
        noise = replace(found.noise, sd=(a, b))
        assert _restricted(found.at, noise) <= best + 1e-5


def test_covariance_is_generalised_least_squares() -> None:
    fit = _known()
    inverse = np.linalg.inv(_dense(fit.at, fit.noise))
    expected = np.linalg.inv(fit.at.jacobian.T @ inverse @ fit.at.jacobian)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs((fit.covariance - expected) / scale).max() < 1e-6
    # θ is stationary: no combination of parameters explains any of what is left.
    gradient = fit.at.jacobian.T @ inverse @ fit.at.residual
    assert float(gradient @ expected @ gradient) < 1e-8


def test_setting_errors_are_the_conditional_mean() -> None:
    """E[η | r] of the joint Gaussian of η and r = N η + noise."""
    fit = _known()
    misfit = fit.at.residual
    covariance = _dense(fit.at, fit.noise)
    expected = np.concatenate(
        [sd**2 * m.T @ np.linalg.solve(covariance, misfit)
         for m, sd in zip(fit.at.settings, fit.noise.sd, strict=True)]
    )  # fmt: skip
    white = whitener(fit.at.settings, fit.noise.ratio)
    found = setting_errors(fit.at, white, fit.noise.ratio, misfit)
    assert np.allclose(found, expected, rtol=1e-7, atol=1e-14)
    assert np.allclose(fit.eta, expected, atol=1e-9)


def tangent_leak(fit: Fit) -> float:
    """Change of the balanced residual when all directions move, as a share of the move."""
    data, reference = fit.observations, fit.observations.reference
    step = 1e-5 * np.random.default_rng(5).standard_normal(reference.eta_size)
    away = reference.move(fit.eta, step)
    before, after = (balance(fit.model, fit.theta, eta, data) for eta in (fit.eta, away))
    size = np.abs(reference.truth(away) - reference.truth(fit.eta)).max() / data.sigma.min()
    assert size > 1e-2  # the move itself is seen by the readings
    # The sign of what is kept is free.
    return float(np.abs(np.abs(after.residual) - np.abs(before.residual)).max() / size)


def test_moving_a_direction_leaves_the_projected_residual() -> None:
    assert _norm().at.residual.size == _norm().observations.n
    assert tangent_leak(_norm()) < 1e-4


@pytest.mark.parametrize("kind", ["known", "norm"])
def test_leaving_rows_out_is_a_full_refit(kind: str) -> None:
    fit = _known() if kind == "known" else _norm()
    moved = 0.0
    for rows in (np.array([0]), np.array([7, 8]), np.arange(10, 15)):
        refit = fit_model(
            fit.model, fit.observations.without(rows), start=fit.theta, noise=fit.noise
        )
        assert refit.converged
        away = theta_without(fit, rows) - refit.theta
        # One Gauss-Newton step: what is left is second order, far below the uncertainty.
        assert np.all(np.abs(away) < 0.02 * refit.sd)
        moved = max(moved, float(np.max(np.abs(refit.theta - fit.theta) / refit.sd)))
    assert moved > 0.2


@pytest.mark.parametrize("rows", [80, 400])
def test_a_whitener_of_blocks_is_that_of_the_dense_matrix(rows: int) -> None:
    """Two components: runs of ten share one, pairs across two runs the other, some none."""
    rng = np.random.default_rng(rows)
    first, second = np.zeros((2, rows, rows // 2))
    at = np.arange(rows)
    first[at, at // 10] = rng.standard_normal(rows)
    second[at, at % 10 + 10 * (at // 20)] = rng.standard_normal(rows)
    second[5::20] = 0.0
    dense = np.eye(rows) + 4.0 * first @ first.T + 0.25 * second @ second.T
    white, data = whitener((first, second), (2.0, 0.5)), rng.standard_normal((rows, 3))
    assert sum(len(own) for own, _ in white.blocks) == (1 if rows == 80 else rows // 20)
    np.testing.assert_allclose(white(data).T @ white(data), data.T @ np.linalg.solve(dense, data))
    np.testing.assert_allclose(white.weigh(data), np.linalg.solve(dense, data), atol=1e-12)
    assert white.log_det == pytest.approx(np.linalg.slogdet(dense)[1])
    assert whitener((first, second), (0.0, 0.0)).plain


@pytest.mark.parametrize("seed", [1, 13, 15, 18, 55, 58])
def test_a_free_gross_error_is_not_mistaken_for_a_setting(seed: int) -> None:
    """From the plain start, the fit finds what it finds when it starts at the truth."""
    rng = np.random.default_rng(seed)
    data, axis, row = bench(seed, 20, shared=seed % 2 == 1), "xyz"[seed % 3], int(rng.integers(20))
    model = base_model().plus(record_error(row, "it", axis))
    theta = ordinary_theta(model, data, seed)
    theta[-1] = rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(1.3, 3.3)  # mg
    noisy = draw(model, theta, data, seed)
    plain, near = fit_model(model, noisy), fit_model(model, noisy, start=theta)
    assert plain.converged
    assert plain.log_likelihood == pytest.approx(near.log_likelihood, abs=1e-3)
    assert abs(plain.theta[-1] - theta[-1]) < 4.5 * plain.sd[-1]


def _rig(seed: int, rows: int = 30) -> tuple[Array, tuple[Array, ...], Array]:
    """A jacobian (N, 5), two settings of few columns and one of as many as numbers, and data."""
    rng = np.random.default_rng(seed)
    jacobian = rng.standard_normal((rows, 5))
    few = tuple(rng.standard_normal((rows, q)) for q in (3, 6))
    return jacobian, (*few, rng.standard_normal((rows, rows))), rng.standard_normal((rows, 4))


def _whole(components: tuple[Array, ...], ratio: tuple[float, ...]) -> Array:
    whole = np.eye(len(components[0]))
    for matrix, size in zip(components, ratio, strict=True):
        whole += size**2 * matrix @ matrix.T
    return whole


def _owners(seed: int, rows: int = 30) -> Array:
    """A component of settings that one, two, three or four numbers share, some numbers none."""
    rng = np.random.default_rng(seed + 1000)
    owner = rng.permutation(np.repeat(np.arange(14), rng.integers(1, 5, 14))[: rows - 2])
    matrix = np.zeros((rows, 14))
    matrix[np.arange(owner.size), owner] = rng.standard_normal(owner.size)
    return matrix[:, matrix.any(axis=0)]


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 999), sizes=st.lists(st.floats(0.0, 30.0), min_size=3, max_size=3))
@pytest.mark.parametrize("kind", ["shared by all", "settings", "narrow"])
def test_the_restricted_likelihood_is_that_of_dense_matrices(
    kind: str, seed: int, sizes: list[float]
) -> None:
    """y'Py and log|V| + log|J'V⁻¹J| - log|J'J|, by their definitions, and V⁻¹'s diagonal."""
    jacobian, components, data = _rig(seed)
    third = {"shared by all": components[2:], "settings": (_owners(seed),), "narrow": ()}[kind]
    components = (*components[:2], *third)
    ratio = tuple(sizes[: len(components)])
    left = restrict(jacobian, components)
    assert left.wide == (2 if third else -1)
    assert (left.out.shape[1] > 0) == (kind == "settings")
    assert len(left.out) - left.out.shape[1] == len(jacobian) - jacobian.shape[1]
    found = left.at(np.array(ratio))
    power = [found.power(found.solve(left.turn(one))) for one in data.T]
    expected, logs = _projected(jacobian, _whole(components, ratio), data)
    assert power == pytest.approx(expected, rel=1e-7)
    assert found.log_det == pytest.approx(logs, rel=1e-8, abs=1e-8)
    unit = np.eye(len(jacobian))
    turned = _projected(jacobian, _whole(components, ratio), unit)[0]
    assert np.sum(found.own) == pytest.approx(np.sum(turned), rel=1e-8)


def _projected(jacobian: Array, covariance: Array, data: Array) -> tuple[Array, float]:
    """y'Py of every column, and log|V| + log|J'V⁻¹J| - log|J'J|."""
    inverse = np.linalg.inv(covariance)
    weighted = jacobian.T @ inverse
    project = inverse - weighted.T @ np.linalg.solve(weighted @ jacobian, weighted)
    logs = -np.linalg.slogdet(inverse)[1] + np.linalg.slogdet(weighted @ jacobian)[1]
    logs -= np.linalg.slogdet(jacobian.T @ jacobian)[1]
    return np.einsum("nd,nm,md->d", data, project, data), float(logs)


def test_what_large_settings_leave_is_not_lost() -> None:
    """Settings that scatter by a million times the noise: the rest is known to a part in 1e6."""
    jacobian, components, data = _rig(2)
    column = components[0]
    left = restrict(jacobian, (column,))
    both = np.column_stack([jacobian, column])
    rest = data - both @ np.linalg.lstsq(both, data, rcond=None)[0]
    moved = left.turn(data + 1e6 * column @ np.ones((column.shape[1], data.shape[1])))
    expected = pytest.approx((rest**2).sum(axis=0) + column.shape[1], rel=1e-5)
    found = left.at(np.array([1e6]))
    assert [found.power(found.solve(one)) for one in moved.T] == expected
