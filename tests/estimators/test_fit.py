"""Fits: objectives, priors, kinds, quantiles, and when one is given up."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from imucalib.core.balance import Balanced, Noise
from imucalib.core.model import Model
from imucalib.core.prior import Prior
from imucalib.core.references import KnownVector
from imucalib.effects import named
from imucalib.estimators import least_squares
from imucalib.estimators.corrected import OBJECTIVES
from imucalib.estimators.least_squares import fit
from imucalib.estimators.variance import NoiseEstimate, estimate_with_prior, kind_chance
from imucalib.units import DEG
from worlds.bench import base_model, bench, draw, ordinary_theta, tumble
from worlds.sheets import direction

G = 9.8


def world() -> tuple[np.ndarray, KnownVector, np.ndarray, np.ndarray]:
    """Corrected readings (n, 3) near their reference; two rows near +y, one of +z, none of +x."""
    rng = np.random.default_rng(1)
    i = np.array([0.1, 89.8, 0.0, 30.0, -45.0, 70.0, -10.0])
    t = np.array([0.2, 40.0, 359.9, 100.0, 200.0, 300.0, 359.0])
    setting = np.arange(len(i))
    reference = KnownVector(i * DEG, t * DEG, G, setting, setting)
    return G * direction(i, t) + 0.05 * rng.normal(size=(len(i), 3)), reference, i, t


def test_the_papers_is_its_equation_5() -> None:
    """The first row within half a degree of an axis as a vector, every row by its norm."""
    corrected, reference, *_ = world()
    found, _ = OBJECTIVES["paper"](corrected, reference)
    size = np.sqrt(np.sum(corrected**2, axis=1)) / G - 1.0
    y, z = corrected[0] / G - [0.0, 1.0, 0.0], corrected[1] / G - [0.0, 0.0, 1.0]
    np.testing.assert_allclose(found, [*size, *y, *z], atol=1e-14)


def test_that_of_angles_weighs_the_tool_face_by_the_cosine_of_the_inclination() -> None:
    """In rad, the tool-face by the shorter way round."""
    corrected, reference, i, t = world()
    found, _ = OBJECTIVES["angles"](corrected, reference)
    norm = np.sqrt(np.sum(corrected**2, axis=1))
    inclined = np.degrees(np.arcsin(corrected[:, 2] / norm)) - i
    turned = np.degrees(np.arctan2(corrected[:, 0], corrected[:, 1])) - t
    turned = (turned + 540.0) % 360.0 - 180.0
    expected = [DEG * inclined, DEG * turned * np.cos(DEG * i), norm / G - 1.0]
    np.testing.assert_allclose(found, np.concatenate(expected), atol=1e-12)


@pytest.mark.parametrize("name", OBJECTIVES)
def test_slopes_are_differences(name: str) -> None:
    corrected, reference, *_ = world()
    _, slope = OBJECTIVES[name](corrected, reference)
    for row, axis in np.ndindex(corrected.shape):
        step = np.zeros_like(corrected)
        step[row, axis] = 1e-6
        up, down = (OBJECTIVES[name](corrected + s, reference)[0] for s in (step, -step))
        np.testing.assert_allclose(slope[:, row, axis], (up - down) / 2e-6, atol=1e-7)


def test_a_fit_that_creeps_three_times_in_a_row_is_given_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    solve, done = least_squares.minimise, []

    def slow(*arguments: Any) -> Any:
        done.append(1)
        return replace(solve(*arguments), converged=False)

    monkeypatch.setattr(least_squares, "minimise", slow)
    model, data = base_model(), bench(1, 30)
    assert not fit(model, draw(model, ordinary_theta(model, data, 2), data, 3)).converged
    assert len(done) == 3


N, P = 40, 4


def balanced(residual: np.ndarray, jacobian: np.ndarray) -> Balanced:
    """Without settings, in units of the noise."""
    ones = np.ones((N, 1))
    return Balanced(residual, jacobian, (), (), ones[..., None], np.arange(N), ones)


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
        at = balanced(values - slopes @ theta, slopes)
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


NINE = base_model(("bias", "scale", "non_orthogonality"))


def _prior(model: Model, context, share: float, logs: tuple[tuple[float, float], ...]) -> Prior:  # type: ignore[no-untyped-def]
    """About the usual, each parameter with a share of its typical size."""
    sd = share * np.array([p.typical for p in model.parameters(context)])
    return Prior(model.start(context), np.diag(1.0 / sd), np.array(logs))


@pytest.mark.parametrize("width", [100.0, 1e4])
@pytest.mark.parametrize("known", [True, False])
def test_a_kind_that_says_nothing_changes_nothing(known: bool, width: float) -> None:
    """With wide priors the estimate is that of restricted maximum likelihood, settings and all."""
    model, data = (base_model(), bench(4, 60)) if known else (NINE, tumble(4, 60))
    made = draw(model, ordinary_theta(model, data, 4), data, 5)
    plain = fit(model, made)
    count = 1 + len(plain.noise.component)
    wide = fit(model, made, prior=_prior(model, made.context, width, ((-3.0, 50.0),) * count))
    assert wide.converged
    assert np.all(np.abs(wide.theta - plain.theta) < 0.02 * plain.sd)
    assert wide.sd == pytest.approx(plain.sd, rel=0.01)
    assert wide.noise.factor == pytest.approx(plain.noise.factor, rel=0.01)
    assert wide.noise.sd == pytest.approx(plain.noise.sd, rel=0.03)
    assert wide.noise_sd == pytest.approx(plain.noise_sd, rel=0.05)


@pytest.mark.slow
def test_few_rests_of_one_of_a_kind_have_honest_sds() -> None:
    """Sixty devices drawn from their kind, six rests each by the size of gravity: nine parameters
    from six numbers, by normal theory z is standard normal."""
    z, strange = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        data, known = tumble(seed, 6), bench(seed, 6, exact=True)
        prior = _prior(NINE, data.context, 0.2, ((0.0, 0.2),))
        theta = prior.mean + np.diag(1.0 / np.diag(prior.root)) @ rng.standard_normal(9)
        made = data.set_reading(draw(NINE, theta, known, seed + 1000).reading)
        found = fit(NINE, made, prior=prior)
        assert found.converged
        z.append((found.theta - theta) / found.sd)
        strange.append(kind_chance(found))
    assert 0.9 < float(np.std(z)) < 1.1
    assert 0.3 < np.mean(np.array(strange) < 0.5) < 0.7  # uniform; five standard errors are 0.32
    assert min(strange) > 1e-4


def test_one_of_another_kind_is_strange() -> None:
    data, known = tumble(3, 12), bench(3, 12, exact=True)
    prior = _prior(NINE, data.context, 0.1, ((0.0, 0.2),))
    theta = prior.mean.copy()
    theta[0] += 8.0 / prior.root[0, 0]
    made = data.set_reading(draw(NINE, theta, known, 7).reading)
    assert kind_chance(fit(NINE, made, prior=prior)) < 1e-6


def test_what_the_fleet_knows_of_the_noise_is_weighed() -> None:
    """Of eight numbers the noise is told by the kind; of two hundred by the data."""
    wrong = ((np.log(3.0), 0.1),)
    for count, low, high in ((8, 2.0, 3.5), (200, 0.9, 1.8)):
        data, known = tumble(9, count), bench(9, count, exact=True)
        prior = _prior(NINE, data.context, 1.0, wrong)
        made = data.set_reading(draw(NINE, ordinary_theta(NINE, known, 9), known, 10).reading)
        assert low < fit(NINE, made, prior=prior).noise.factor < high


def test_a_prior_moves_an_effect_that_the_rows_cannot_show() -> None:
    """Squares beside nine parameters from nine rests: nothing to tell, the prior stands."""
    model = Model((*NINE.effects, named("quadratic")))
    data, known = tumble(2, 9), bench(2, 9, exact=True)
    prior = _prior(model, data.context, 0.5, ((0.0, 0.2),))
    theta = prior.mean.copy()
    made = data.set_reading(draw(NINE, theta[:9], known, 3).reading)
    found = fit(model, made, prior=prior)
    own = found.model.slices(data.context)["quadratic"]
    assert np.all(found.sd[own] <= 1.0 / np.diag(prior.root)[own] * (1.0 + 1e-9))
    assert found.null_directions == ()
