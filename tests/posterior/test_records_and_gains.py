"""Wrong records, runs that count less, gains: each against a formula or a refit of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from scipy.stats import t as student

from imucalib.core.model import Model
from imucalib.core.observations import NoisePrior, Observations
from imucalib.effects.record_error import record_error
from imucalib.estimators.least_squares import fit
from imucalib.posterior.candidates import effects_to_search
from imucalib.posterior.closed_loop.closed import close_loop
from imucalib.posterior.closed_loop.recorded import course_of
from imucalib.posterior.held_out import difference, without_records
from imucalib.posterior.odds import UNLIKE
from imucalib.posterior.search.explored import SearchStart
from imucalib.posterior.slips.trials import log_density
from imucalib.units import MG
from worlds.at_rest import at_rest, worn
from worlds.bench import BASE, NINE, SIGMA, base_model, bench, draw, ordinary_theta


def exact(seed: int, n: int = 30) -> Observations:
    """A bench whose angles are as they were set."""
    base, data = base_model(), bench(seed, n, exact=True)
    return draw(base, ordinary_theta(base, data, seed), data, seed + 1)


@pytest.mark.parametrize("seed", range(4))
def test_no_record_of_a_clean_recording_is_accused(seed: int) -> None:
    asked = effects_to_search(("quadratic",), (), {}, lambda effect: True)
    assert not close_loop(base_model(NINE), at_rest(seed, 30), asked).loop.records


SENSOR = {
    **{f"bias_{a}": 50.0 for a in "xyz"},
    **{f"scale_{a}": 0.02 for a in "xyz"},
    **{f"cross_{pair}": 0.01 for pair in ("yx", "zx", "zy")},
}


def few(seed: int, off: float) -> Observations:
    """18 rests of a sensor as a bench knows it, one of them off (mg) along gravity."""
    data = replace(at_rest(seed, 18), noise_prior=NoisePrior(10.0, 1e-3, SENSOR))
    reading = data.reading.copy()
    reading[9] *= 1.0 + 1e-3 * off
    return data.set_reading(reading)


@pytest.mark.parametrize("seed", range(4))
def test_one_wrong_record_of_few_rests_is_accused(seed: int) -> None:
    asked = effects_to_search(("quadratic",), (), {}, lambda effect: True)
    told = [close_loop(base_model(NINE), few(seed, off), asked).loop.records for off in (0.0, 30.0)]
    assert [[record.row for record in records] for records in told] == [[], [9]]


def test_the_density_of_a_sheet_is_the_integral_over_its_noise() -> None:
    """Of two sheets whose noise differs twentyfold: what is known of the sensor is no number that
    tells of the noise. The integral is over s, of N(r, s² + J Σ Jᵀ) / s."""
    asked, every = effects_to_search(("quadratic",), (), {}, lambda effect: True), []
    for off in (0.0, 30.0):
        data = few(3, off)
        one = fit(base_model(NINE), data)
        found = SearchStart.of(one, asked).explore()
        start = np.array([p.start for p in one.parameters])
        sd = np.array([SENSOR[p.name] for p in one.parameters])
        left = one.at.residual + one.at.jacobian @ (one.theta - start)
        known = (one.at.jacobian * sd) @ (one.at.jacobian * sd).T
        sizes = np.geomspace(0.03, 300.0, 400)
        logs = [multivariate_normal.logpdf(left, cov=s**2 * np.eye(18) + known) for s in sizes]
        every.append((log_density(found), float(np.logaddexp.reduce(logs))))
    stated, true = np.diff(every, axis=0)[0]
    assert true < -15.0
    assert stated == pytest.approx(true, abs=1.5)


def test_a_wrong_record_is_off_by_what_a_refit_without_it_predicts() -> None:
    """Size and sd of the number that is 40 mg off, from θ and its covariance without the row."""
    data, row = exact(5), 11
    reading = data.reading.copy()
    reading[row, 0, 1] += 40.0 * MG
    asked = effects_to_search(("quadratic",), (), {}, lambda effect: True)
    (said,) = close_loop(base_model(), data.set_reading(reading), asked).loop.records
    rest = fit(base_model(), data.without(np.array([row])))
    own = data.take(np.array([row]))
    at = rest.model.predict(
        rest.theta, own.reference.truth(np.zeros(own.reference.eta_size)), own.context
    )
    steps = 1e-6 * np.array([p.typical for p in rest.parameters])
    slope = []
    for k, step in enumerate(steps):
        moved = rest.theta.copy()
        moved[k] += step
        other = rest.model.predict(
            moved, own.reference.truth(np.zeros(own.reference.eta_size)), own.context
        )
        slope.append((other.reading - at.reading)[0, 0] / step)
    jacobian = np.array(slope).T
    spread = jacobian @ rest.covariance @ jacobian.T + np.eye(3) * (rest.noise.factor * SIGMA) ** 2
    assert said.where == data.label[row]
    assert said.channel == "y"
    assert said.size == pytest.approx((reading[row, 0, 1] - at.reading[0, 0, 1]) / MG, abs=0.2)
    assert said.sd == pytest.approx(np.sqrt(spread[1, 1]) / MG, rel=0.15)


def test_a_records_own_error_is_no_part_of_a_calibration() -> None:
    data = exact(5)
    one = fit(Model((*base_model().effects, record_error(3, "row 4"))), data)
    theta = without_records(one, one.theta)
    assert np.all(one.theta[-3:] != 0.0)
    assert not theta[-3:].any()
    np.testing.assert_array_equal(theta[:-3], one.theta[:-3])


def test_the_interval_of_a_gain_is_widened_for_shared_training_data() -> None:
    """Nadeau and Bengio: Student's with n - 1 degrees of freedom, times sqrt(1 + K / (K - 1))."""
    rng = np.random.default_rng(3)
    before, after = 2.0 + rng.random(12), 1.5 + rng.random(12)
    found = difference(before, after, np.arange(12), 6, "mean")
    change = before - after
    reach = student.ppf(0.975, 11) * np.std(change, ddof=1) / np.sqrt(12) * np.sqrt(1.0 + 6.0 / 5.0)
    assert found.low == pytest.approx(change.mean() - reach)
    assert found.high == pytest.approx(change.mean() + reach)


def test_runs_unlike_the_others_count_less() -> None:
    """Three of sixty are 8 mg off: their variance grows with how far they are, others' does not."""
    data, rows = worn(2, 60), np.array([7, 30, 51])
    reading = data.reading.copy()
    reading[rows] *= 1.008
    plain = fit(base_model(NINE), data.set_reading(reading))
    course, _ = course_of(plain, np.zeros(data.n))
    assert course.light >= 3
    assert course.variance[rows].min() > 3.0 / UNLIKE
    assert np.median(course.variance) == pytest.approx(1.0)


@pytest.mark.parametrize("seed", range(3))
def test_axes_of_a_clean_bench_have_one_noise(seed: int) -> None:
    asked = effects_to_search(("quadratic",), (), {}, lambda effect: True)
    start = SearchStart.of(fit(base_model(BASE), exact(seed)), asked)
    np.testing.assert_array_equal(start.axis_noise(), 1.0)


def test_an_axis_of_more_noise_is_seen() -> None:
    data = exact(1, 40)
    reading = data.reading.copy()
    reading[:, 0, 2] += 1.5 * MG * np.random.default_rng(0).normal(size=40)
    asked = effects_to_search(("quadratic",), (), {}, lambda effect: True)
    noise = SearchStart.of(fit(base_model(BASE), replace(data, reading=reading)), asked)
    x, y, z = noise.axis_noise()[0]
    assert x == y
    assert 2.0 < z / x < 9.0
