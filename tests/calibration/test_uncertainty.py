"""Uncertainty: first order against Monte Carlo, and intervals that cover as often as they say."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom

from imucalib.calibration.uncertainty import angle_uncertainty, correcting, force_slope
from imucalib.core.effect import Context
from imucalib.core.fit import Fit
from imucalib.core.references import angles_of, unit_vector
from imucalib.effects import named
from imucalib.effects.record_error import record_error
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.units import DEG
from worlds.bench import (
    GRAVITY,
    NINE,
    base_model,
    bench,
    draw,
    ordinary_theta,
    tumble,
)

Array = NDArray[np.float64]


@cache
def _fit() -> Fit:
    model = base_model().plus(named("inclination_zero")).plus(record_error(3, "row 4"))
    data = bench(81, 30)
    return fit_model(model, draw(model, ordinary_theta(model, data, 82), data, 83))


def _attitudes() -> tuple[Array, Array]:
    return np.array([-60.0, -20.0, 0.0, 35.0, 70.0]) * DEG, np.array(
        [10.0, 80, 170, 250, 340]
    ) * DEG


def test_force_slope_is_the_derivative_of_correct() -> None:
    fit, (i, t) = _fit(), _attitudes()
    force = GRAVITY * unit_vector(i, t)[:, None]
    slope, inverse = force_slope(fit, force)
    model, context = correcting(fit.model), Context(len(i))
    whole, own = fit.model.slices(fit.observations.context), model.slices(context)
    theta = np.concatenate([fit.theta[whole[n]] for n in model.names])
    reading = model.predict(theta, force, context).reading
    for name, part in own.items():
        for k in range(part.start, part.stop):
            step = np.zeros(theta.size)
            step[k] = 1e-5 * model.parameters(context)[k].typical
            up, down = (model.correct(theta + s, reading, context)[:, 0] for s in (step, -step))
            column = whole[name].start + k - part.start
            numeric = (up - down) / (2.0 * step[k])
            assert np.allclose(slope[..., column], numeric, rtol=1e-5, atol=1e-8)
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 1e-5
        up, down = (model.correct(theta, reading + s, context)[:, 0] for s in (step, -step))
        assert np.allclose(inverse[..., axis], (up - down) / 2e-5, atol=1e-8)


def test_degrees_of_freedom_of_one_noise_are_n_minus_p() -> None:
    """Without settings the variance is one χ²: Satterthwaite's answer is exact."""
    model, data = base_model(), bench(87, 20, exact=True)
    fit = fit_model(model, draw(model, ordinary_theta(model, data, 1), data, 2))
    for direction in np.eye(fit.theta.size):
        assert fit.interval_dof(direction) == pytest.approx(60 - 12, rel=1e-6)


def _inside(fit: Fit, theta: Array) -> Array:
    """Which of the parameters' 95 % intervals hold the truth, and which angles' do."""
    within = [
        abs(fit.theta[k] - theta[k]) <= fit.half_width(row)
        for k, row in enumerate(np.eye(theta.size))
    ]
    return np.array(within)


def _angles_inside(fit: Fit, theta: Array) -> Array:
    i, t = _attitudes()
    context = Context(len(i))
    reading = fit.model.predict(theta, GRAVITY * unit_vector(i, t)[:, None], context).reading
    found_i, found_t = angles_of(fit.model.correct(fit.theta, reading, context)[:, 0])
    away = np.mod(found_t - t + np.pi, 2.0 * np.pi) - np.pi
    width = angle_uncertainty(fit, i, t, GRAVITY, 0.0)
    inside_i = np.abs(found_i - i) / DEG <= width.inclination_95
    return np.concatenate([inside_i, np.abs(away) / DEG <= width.tool_face_95])


BENCHES = 40


@cache
def _benches() -> tuple[tuple[Fit, Array], ...]:
    model, found = base_model(), []
    for seed in range(BENCHES):
        data = bench(seed, 15, shared=seed % 2 == 0)
        theta = ordinary_theta(model, data, 500 + seed)
        found.append((fit_model(model, draw(model, theta, data, 900 + seed)), theta))
    return tuple(found)


def _bounds(level: float, count: int) -> tuple[int, int]:
    """0.01 % and 99.99 % quantiles of the number of intervals that hold the truth."""
    return int(binom.ppf(0.0001, count, level)), int(binom.ppf(0.9999, count, level))


@pytest.mark.slow
def test_intervals_of_parameters_cover() -> None:
    """Each parameter over the benches; sets of independent benches are binomial."""
    inside = np.array([_inside(fit, theta) for fit, theta in _benches()])
    low, _ = _bounds(0.95, BENCHES)
    assert np.all(inside.sum(axis=0) >= low), inside.sum(axis=0)
    # All together they are neither too short nor uselessly long. 0.04 are 2.3 standard
    # deviations of a third as many independent intervals: one bench's parameters share something.
    assert 0.91 <= inside.mean() <= 0.99


@pytest.mark.slow
def test_intervals_of_angles_cover() -> None:
    inside = np.array([_angles_inside(fit, theta) for fit, theta in _benches()])
    low, _ = _bounds(0.95, BENCHES)
    assert np.all(inside.sum(axis=0) >= low), inside.sum(axis=0)
    assert 0.90 <= inside.mean() <= 0.99


def test_intervals_by_the_norm_alone_cover() -> None:
    model, inside = base_model(NINE), []
    for seed in range(BENCHES):
        known, data = bench(seed, 15, exact=True), tumble(seed, 15)
        theta = ordinary_theta(model, data, 500 + seed)
        reading = draw(model, theta, known, 700 + seed).reading
        inside.append(_inside(fit_model(model, data.with_reading(reading)), theta))
    low, _ = _bounds(0.95, BENCHES)
    assert np.all(np.sum(inside, axis=0) >= low), np.sum(inside, axis=0)
    assert 0.91 <= np.mean(inside) <= 0.99
