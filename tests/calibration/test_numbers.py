"""Numbers that a calibration states, by definition, and intervals that cover as they say."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import binom

from imucalib.arrays import Array
from imucalib.calibration.angles import angles_at_rests, angles_of_samples
from imucalib.calibration.calibration import Calibration, matrices
from imucalib.calibration.findings import advice_of, find_hidden
from imucalib.calibration.uncertainty import angle_uncertainty
from imucalib.core.effect import Context
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.references import angles_of, unit_vector
from imucalib.effects import named
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.rests.segments import Segments
from imucalib.units import DEG, MG, STANDARD_GRAVITY
from worlds.bench import GRAVITY, NINE, base_model, bench, draw, ordinary_theta, tumble
from worlds.stated import stated


def angles(force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Paper 004's formulae (1) and (2), written a second time, deg."""
    x, y, z = force.T
    return np.degrees(np.arctan(z / np.sqrt(x**2 + y**2))), np.degrees(np.arctan2(x, y)) % 360


def by_hand() -> Calibration:
    """Nine parameters and a mounting, with a full covariance."""
    rng = np.random.default_rng(3)
    # The mounting is last here, first in the model.
    sizes = {"bias": 20.0, "scale": 0.02, "non_orthogonality": 0.01, "mounting": 1.0}
    values = {name: size * rng.normal(size=3) for name, size in sizes.items()}
    root = np.diag(np.repeat([*sizes.values()], 3)) @ rng.normal(size=(12, 12)) * 1e-3
    return stated(values, root @ root.T, gravity=9.81, facts={"noise": {"reading_mg": 0.4}})


def rests_in(ways: np.ndarray, samples: int = 25) -> tuple[Segments, np.ndarray]:
    """Rests of equal length in some attitudes, every second sample half a mg off to either side."""
    n = len(ways)
    spans = tuple((((samples * k, samples * (k + 1)),),) for k in range(n))
    force = np.repeat(9.81 * ways, samples, axis=0)
    nothing = np.zeros((n, 1, 3))
    return Segments(
        start=10.0 * np.arange(n), stop=10.0 * np.arange(n) + 4.0, triads=("imu0",), spans=spans,
        samples=np.full((n, 1), samples), mean=nothing,
        rate=nothing, temperature=np.zeros((n, 1)), noise=np.array([[1.0, 2.0, 3.0]]) * MG,
        rate_noise=np.zeros((1, 3)), step=np.zeros((1, 3)), rate_step=np.zeros((1, 3)),
    ), force  # fmt: skip


def test_sds_are_the_derivatives_of_the_correction() -> None:
    """Of every parameter and of the reading, by small differences; noise falls with the root of the
    samples, what a position repeats to does not."""
    calibration, rng = by_hand(), np.random.default_rng(1)
    ways = rng.normal(size=(6, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    ways[5] = [0.03, 0.0, np.sqrt(1.0 - 9e-4)]
    segments, force = rests_in(ways)
    found = angles_at_rests(calibration, force, segments, 0)
    np.testing.assert_allclose(found.t, 10.0 * np.arange(6) + 2.0)
    np.testing.assert_allclose(found.norm_error, 0.0, atol=1e-9)
    reading = STANDARD_GRAVITY * ways
    model, theta = calibration.model()
    reading = model.predict(theta, reading[:, None], Context(6)).reading[:, 0]

    def seen(change: np.ndarray, read: np.ndarray) -> np.ndarray:
        named = zip(calibration.parameters, change, strict=True)
        moved = tuple(replace(p, value=p.value + float(d)) for p, d in named)
        i, t = angles(replace(calibration, parameters=moved).apply(read))
        return np.array([i, t])

    slope = []
    for k in range(12):
        step = 1e-5 * calibration.parameters[k].sd * np.eye(12)[k]
        both = seen(step, reading) - seen(-step, reading)
        slope.append(((both + 180.0) % 360.0 - 180.0) / (2.0 * step[k]))
    own = np.sqrt(np.einsum("pan,pq,qan->an", np.array(slope), calibration.covariance,
                            np.array(slope)))  # fmt: skip
    noise = np.hypot(0.4, np.array([1.0, 2.0, 3.0]) / 5.0) * MG
    square = own**2
    for axis in range(3):
        step = 1e-6 * np.eye(3)[axis]
        both = seen(np.zeros(12), reading + step) - seen(np.zeros(12), reading - step)
        square = square + (((both + 180.0) % 360.0 - 180.0) / 2e-6 * noise[axis]) ** 2
    np.testing.assert_allclose(found.inclination_calibration_sd, own[0], rtol=1e-4)
    np.testing.assert_allclose(found.inclination_sd, np.sqrt(square[0]), rtol=1e-4)
    np.testing.assert_allclose(found.tool_face_calibration_sd[:5], own[1, :5], rtol=1e-4)
    np.testing.assert_allclose(found.tool_face_sd[:5], np.sqrt(square[1, :5]), rtol=1e-4)
    # Within 2.9 deg of the vertical a tool-face means nothing.
    assert np.isnan(found.tool_face).tolist() == [False] * 5 + [True]
    assert np.isnan(found.tool_face_sd[5])
    every = angles_of_samples(calibration, 1.002 * force, np.arange(150.0), segments, 0)
    assert every.still.all()
    np.testing.assert_allclose(every.norm_error, 2.0 * 9.81 / STANDARD_GRAVITY, rtol=1e-9)
    assert (every.inclination_sd[:25] > found.inclination_sd[0]).all()


def _attitudes() -> tuple[Array, Array]:
    return np.array([-60.0, -20.0, 0.0, 35.0, 70.0]) * DEG, np.array(
        [10.0, 80, 170, 250, 340]
    ) * DEG


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
        inside.append(_inside(fit_model(model, data.set_reading(reading)), theta))
    low, _ = _bounds(0.95, BENCHES)
    assert np.all(np.sum(inside, axis=0) >= low), np.sum(inside, axis=0)
    assert 0.91 <= np.mean(inside) <= 0.99


def test_matrices_are_the_linear_part_and_its_scatter() -> None:
    """raw = S a + c, corrected = M raw + b; lengths of S's rows and angles between them; sds as
    draws of the parameters scatter. What is curved or needs a covariate is left out."""
    rng = np.random.default_rng(0)
    names = ("mounting", "bias", "scale", "non_orthogonality", "quadratic", "temperature_bias")
    model = Model(tuple(named(n) for n in names))
    size = np.array([1.0] * 3 + [30.0] * 3 + [0.02] * 3 + [0.01] * 3 + [2.0] * 3 + [0.5] * 3)
    theta = size * rng.normal(size=18)
    root = 1e-2 * np.diag(size) @ rng.normal(size=(18, 18)) / 4.0
    found = matrices(model, theta, root @ root.T)
    linear = Model(tuple(named(n) for n in names[:4]))
    force = 9.0 * rng.normal(size=(7, 3))
    raw = linear.predict(theta[:12], force[:, None], Context(7)).reading[:, 0]
    np.testing.assert_allclose(raw @ found.M.T + found.b, force, atol=1e-9)
    np.testing.assert_allclose(force @ found.S.T + found.c, raw, atol=1e-9)

    def told(values: np.ndarray) -> np.ndarray:
        predicted = linear.predict(values, np.zeros((1, 1, 3)), Context(1))
        s, c = predicted.d_truth[0, 0], predicted.reading[0, 0]
        unit = [row / np.sqrt(row @ row) for row in s]
        angle = [np.degrees(np.arccos(unit[i] @ unit[j])) for i, j in ((0, 1), (0, 2), (1, 2))]
        m = np.linalg.inv(s)
        return np.concatenate([m.ravel(), -m @ c, s.ravel(), np.sqrt(np.sum(s**2, axis=1)),
                               angle, c / MG])  # fmt: skip

    value = [found.M.ravel(), found.b, found.S.ravel(), found.scale, found.angle, found.bias_mg]
    np.testing.assert_allclose(np.concatenate(value), told(theta[:12]))
    drawn = np.array([told(v[:12]) for v in theta + rng.normal(size=(800, 18)) @ root.T])
    sd = [found.M_sd.ravel(), found.b_sd, found.S_sd.ravel(), found.scale_sd, found.angle_sd,
          found.bias_mg_sd]  # fmt: skip
    np.testing.assert_allclose(np.concatenate(sd), drawn.std(axis=0), rtol=0.12)


def score(name: str, size: float, strength: float, *, absorbed: bool) -> SimpleNamespace:
    return SimpleNamespace(
        name=name, size_m_per_s2=size, lambda_at_typical_size=strength, absorbed=absorbed
    )


def test_what_may_hide_is_told_at_the_size_that_four_of_five_would_find() -> None:
    """4.7 times the noise of its own size; what gravity cannot show at its typical size; nothing
    below a tenth of a mg."""
    scores = [
        score("cubic", 2.0 * MG, 9.4, absorbed=False),
        score("quadratic", 0.5 * MG, 0.0, absorbed=True),
        score("asymmetry", 3.0 * MG, 1.0, absorbed=False),
        score("hysteresis", 1.0 * MG, 48.0, absorbed=False),
        score("cross_axis", 3.0 * MG, 1.0, absorbed=False),
        score("inclination_zero", 9.0 * MG, 1.0, absorbed=True),
        score("bias_step@60s", 9.0 * MG, 1.0, absorbed=False),
    ]
    found = find_hidden(scores, ("cross_axis",))  # type: ignore[arg-type]
    assert [h.name for h in found] == ["quadratic", "asymmetry", "cubic"]
    assert [h.size / MG for h in found] == pytest.approx([0.5, 14.1, 1.0])
    (text,) = advice_of(found)
    assert "cannot show quadratic, whatever the size (0.5 mg rms" in text
    assert advice_of(found[1:]) == ()
