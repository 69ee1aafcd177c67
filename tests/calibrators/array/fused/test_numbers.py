"""What a fused log is weighed by, each number against the same written a second time: biases that
walk, noise that grows, dω/dt from neighbours, instants side by side."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from imucalib.calibrators.array.fused import biases, noise, side_by_side, survey
from imucalib.calibrators.array.fused.instrument import Biases, Instrument, _range
from imucalib.calibrators.array.fused.neighbours import spin_by_neighbours
from imucalib.calibrators.array.fused.noise import ChipNoise, at_rest, fitted_noise
from imucalib.estimators.array.fusion import FusedMotion

Array = NDArray[np.float64]


def segments(start: Array, stop: Array) -> SimpleNamespace:
    return SimpleNamespace(start=start, stop=stop, n=len(start))


def walked(share: float, seed: int, n: int = 40) -> tuple[Array, Array]:
    """Times, and rests' rates (n, 2, 3) of biases that walk, beside what differs between rests."""
    rng = np.random.default_rng(seed)
    at = np.cumsum(rng.uniform(20.0, 40.0, n))
    steps = np.sqrt(share * np.diff(at, prepend=at[0])[:, None, None] / 30.0)
    walk = np.cumsum(steps * rng.standard_normal((n, 2, 3)), axis=0)
    return at, 5.0 + walk + rng.standard_normal((n, 2, 3))


@pytest.mark.parametrize("share", [0.0, 0.1, 10.0])
def test_biases_are_smoothed_as_their_likeliest_walk(share: float) -> None:
    """Restricted likelihood of N(mean, 1 + share · walk) and the best linear prediction, by the
    covariance's own definition."""
    at, seen = walked(share, 3)
    times, found = biases._over_time(segments(at - 1.0, at + 1.0), at, seen)  # type: ignore[arg-type]
    np.testing.assert_allclose(times, at)
    y, one = seen.reshape(40, 6), np.ones((40, 1))
    # What differences between rests say, whatever the mean: the restricted likelihood.
    apart = np.linalg.qr(np.hstack([one, np.eye(40)]))[0][:, 1:]
    walk = np.array([[min(a, b) - at[0] for b in at] for a in at]) / np.mean(np.diff(at))
    best, kept = -np.inf, y
    for ratio in [0.0, *np.geomspace(1e-3, 1e2, 26)]:
        covariance = np.eye(40) + ratio * walk
        inner = apart.T @ covariance @ apart
        own = apart.T @ y
        size = np.mean(np.sum(own * np.linalg.solve(inner, own), axis=0)) / 39.0
        nats = sum(stats.multivariate_normal(cov=size * inner).logpdf(c) for c in own.T)
        inverse = np.linalg.inv(covariance)
        mean = np.sum(inverse, axis=0) @ y / np.sum(inverse)
        if nats > best:
            best, kept = nats, mean + ratio * walk @ inverse @ (y - mean)
    np.testing.assert_allclose(found.reshape(40, 6), kept, atol=1e-8)


def test_two_rests_are_taken_as_they_are_and_many_in_groups() -> None:
    at, seen = walked(1.0, 4, n=2)
    times, found = biases._over_time(segments(at - 1.0, at + 1.0), at, seen)  # type: ignore[arg-type]
    np.testing.assert_allclose(found, seen)
    np.testing.assert_allclose(times, at)
    at, seen = walked(1.0, 5, n=402)  # three a group: 134 groups
    half = np.where(np.arange(402) % 3 == 0, 3.0, 1.0)  # the first rest of three is as long as
    times, _ = biases._over_time(segments(at - half, at + half), at, seen)  # type: ignore[arg-type]
    weight = half.reshape(134, 3)
    np.testing.assert_allclose(times, np.sum(weight * at.reshape(134, 3), 1) / weight.sum(axis=1))


def instrument(beyond: object, count: int = 2) -> SimpleNamespace:
    return SimpleNamespace(
        triads=tuple(SimpleNamespace(name=f"imu{k}") for k in range(count)),
        corrected=lambda t, force, rate: (np.nan_to_num(force), np.nan_to_num(rate)),
        beyond=beyond,
        imus=tuple(f"imu{k}" for k in range(count)),
    )


def test_a_rest_shows_what_accelerometers_differ_by(monkeypatch: pytest.MonkeyPatch) -> None:
    """Believed by (1 cm/s²)² of wander against (2 mm/s²)² of a rest's own error; what an effect
    adds to a gyro is no bias of it; an IMU that is not there has none."""
    monkeypatch.setattr(biases, "_at_rest", lambda made, force: force)
    added = np.zeros((1, 3, 3))
    added[:, 0, 1] = 0.5
    made = instrument(SimpleNamespace(added=lambda motion: (None, added)), count=3)
    mean = np.tile([0.0, 0.0, 9.8], (4, 2, 1)) + [[[0.02, 0, 0]], [[0.04, 0, 0]]] * 2
    mean[:, 1, 1] = 0.1
    rate = np.full((4, 2, 3), 7.0)
    rests = SimpleNamespace(n=4, mean=mean, rate=rate, start=np.arange(4.0) * 10.0,
                            stop=np.arange(4.0) * 10.0 + 2.0)  # fmt: skip
    found = biases.biases_at_rest(rests, {0: 0, 2: 1}, made)  # type: ignore[arg-type]
    believed = 4.0 / (4.0 + (2e-3 / 1e-2) ** 2)
    np.testing.assert_allclose(found.force[[0, 2], 1], believed * np.array([-0.05, 0.05]))
    assert not found.force[1].any()
    np.testing.assert_allclose(found.force[:, [0, 2]], 0.0, atol=1e-12)
    np.testing.assert_allclose(found.rate[:, 0], [[7.0, 6.5, 7.0]] * 4)
    np.testing.assert_allclose(found.rate[:, 1], 0.0)
    np.testing.assert_allclose(found.rate[:, 2], 7.0)


def test_biases_run_straight_between_rests() -> None:
    own = Biases(np.zeros((1, 3)), np.array([10.0, 20.0, 40.0]),
                 np.array([1.0, 3.0, -1.0])[:, None, None] * np.ones((3, 1, 3)))  # fmt: skip
    at = np.array([0.0, 10.0, 15.0, 20.0, 25.0, 40.0, 90.0])
    np.testing.assert_allclose(own.rate_at(at)[:, 0, 0], [1.0, 1.0, 2.0, 3.0, 2.0, -1.0, -1.0])


def test_a_reading_at_the_end_of_its_range_is_clipped() -> None:
    made = SimpleNamespace(accelerometer_range=100.0, gyroscope_range=10.0)
    force, rate = np.array([99.9, 99.7, -99.9]), np.array([9.97, 9.99, -9.99])
    over = Instrument.clipped(made, force, rate)  # type: ignore[arg-type]
    assert [v.tolist() for v in over] == [[True, False, True], [False, True, True]]
    assert _range({"g": 2.0}, "g", 9.8) == 19.6
    assert _range({}, "g", 9.8) == np.inf


def test_noise_grows_with_the_rate() -> None:
    made = ChipNoise(np.array([[3.0, 3.0, 4.0]]), np.array([2.0]), np.inf)
    np.testing.assert_allclose(
        made.variance(np.array([0.0, 2.0]))[:, 0], [[9, 9, 16], [25, 25, 32]]
    )
    assert made.widening == 1.0
    assert ChipNoise(made.rest, made.growth, 5.0).widening == 10.0 / 8.0
    assert not at_rest(made.rest).growth.any()


def test_a_triad_far_out_loses_its_say() -> None:
    """Student's t of ν: (ν + d) / (ν + square); a Gaussian's from thirty sigmas square on."""
    live, square = np.array([[3.0, 2.0]]), np.array([[1.0, 60.0]])
    tails = ChipNoise(np.ones((2, 3)), np.zeros(2), 4.0).share(square, live)
    np.testing.assert_allclose(tails, [[7.0 / 5.0, 6.0 / 64.0]])
    plain = ChipNoise(np.ones((2, 3)), np.zeros(2), np.inf).share(square, live)
    np.testing.assert_allclose(plain, [[1.0, 0.25]])


@pytest.mark.parametrize("nu", [np.inf, 4.0])
def test_the_density_is_that_of_scipy(nu: float) -> None:
    rng = np.random.default_rng(1)
    off, speed = rng.standard_normal((30, 2, 3)), rng.uniform(0.0, 5.0, 30)
    made = ChipNoise(np.array([[0.5, 0.7, 0.9], [1.0, 1.2, 0.8]]), np.array([0.1, 0.3]), nu)
    live = np.ones((30, 2, 3), np.bool_)
    live[::3, 1, 2] = False
    off[~live] = 0.0
    found = noise._of_triads(made, off**2, live, speed)
    for k in range(2):
        total = 0.0
        for t in range(30):
            on = live[t, k]
            shape = np.diag(made.rest[k, on] ** 2 + (speed[t] * made.growth[k]) ** 2)
            one = (stats.multivariate_t(shape=shape, df=nu) if np.isfinite(nu)
                   else stats.multivariate_normal(cov=shape))  # fmt: skip
            total += float(one.logpdf(off[t, k, on]))
        assert found[k] == pytest.approx(total)


def test_the_likeliest_noise_is_found() -> None:
    """Growth of two IMUs, Gaussian and with tails, over a share of the variance that is left."""
    rng = np.random.default_rng(2)
    speed, rest = rng.uniform(2.0, 12.0, 800), np.full((2, 3), 0.1)
    growth = np.array([0.05, 0.05])
    sd = np.sqrt(rest**2 + (speed[:, None, None] * growth[:, None]) ** 2)
    left = np.full((800, 2), 0.5)
    normal = sd * rng.standard_normal((800, 2, 3)) * np.sqrt(0.5)
    live = np.ones(normal.shape, np.bool_)
    found = fitted_noise(normal, live, left, speed, rest)
    assert found.freedom >= 25.0
    np.testing.assert_allclose(found.growth, 0.05, rtol=0.15)
    heavy = normal / np.sqrt(rng.chisquare(4.0, (800, 2, 1)) / 4.0)
    tails = fitted_noise(heavy, live, left, speed, rest)
    assert tails.freedom in (3.0, 4.0, 6.0)
    np.testing.assert_allclose(tails.growth, 0.05, rtol=0.25)
    apart = normal * np.where(np.arange(2)[:, None] == 0, 1.0, 1.8)
    each = fitted_noise(apart, live, left, speed, rest)
    assert each.growth[1] / each.growth[0] == pytest.approx(1.8, rel=0.25)
    still = fitted_noise(normal / sd * rest, live, left, speed, rest)
    assert still.growth.max() < 0.01


def moved(t: Array, hertz: float, sd: tuple[float, float], rng: np.random.Generator) -> FusedMotion:
    """ω of one tone with noise; dω/dt as accelerometers show it."""
    w = 2.0 * np.pi * hertz
    rate, spin = np.sin(w * t)[:, None] * np.ones(3), w * np.cos(w * t)[:, None] * np.ones(3)
    covariance = np.tile(np.diag([1.0] * 3 + [sd[0] ** 2] * 3 + [sd[1] ** 2] * 3), (len(t), 1, 1))
    return FusedMotion(
        np.zeros_like(rate), spin + sd[0] * rng.standard_normal(spin.shape),
        rate + sd[1] * rng.standard_normal(rate.shape), covariance,
    )  # fmt: skip


def test_neighbours_say_dw_dt_as_well_as_their_noise_lets_them() -> None:
    t = np.arange(400) * 0.01
    made = moved(t, 0.5, (1.0, 1e-3), np.random.default_rng(0))
    found = spin_by_neighbours(t, made, None)
    assert found is not None
    spin, precision = found
    np.testing.assert_allclose(spin[1:-1], (made.rate[2:] - made.rate[:-2]) / 0.02)
    # Two rates of 1 mrad/s over 2 Δt; the third difference of so slow a motion adds a little.
    assert 0.5 < np.median(precision[5:-5]) * (2.0 * 1e-6 / 0.02**2) < 1.0 + 1e-9
    assert not precision[[0, -1]].any()
    assert spin_by_neighbours(t[:24], made.take(slice(24)), None) is None
    assert spin_by_neighbours(t[:25], made.take(slice(25)), None) is not None


def test_neighbours_are_believed_of_a_board_at_rest() -> None:
    """The mean positive part of nine noisy squares would add a third to the variance."""
    t = np.arange(2000) * 0.01
    still = replace(moved(t, 0.5, (1.0, 1e-3), np.random.default_rng(0)), spin=np.zeros((2000, 3)))
    noise = 1e-3 * np.random.default_rng(1).standard_normal(still.rate.shape)
    found = spin_by_neighbours(t, replace(still, rate=noise), None)
    assert found is not None
    own = 2.0 * 1e-6 / 0.02**2
    assert 0.99 < np.mean(1.0 / found[1][5:-5]) / own < 1.15


def test_neighbours_are_not_believed_of_a_fast_motion() -> None:
    """The error of a central difference: (2π f)³ Δt² / 6, rms of the tone."""
    t = np.arange(400) * 0.01
    made = moved(t, 8.0, (1.0, 1e-6), np.random.default_rng(0))
    found = spin_by_neighbours(t, made, None)
    assert found is not None
    error = (2.0 * np.pi * 8.0) ** 3 * 1e-4 / 6.0 / np.sqrt(2.0)
    assert 1.0 / np.sqrt(np.median(found[1][10:-10])) == pytest.approx(error, rel=0.25)


def test_a_gap_has_no_neighbours() -> None:
    t = np.arange(100) * 0.01
    t[50:] += 0.05
    made = moved(t, 0.5, (1.0, 1e-3), np.random.default_rng(0))
    found = spin_by_neighbours(t, made, None)
    assert found is not None
    assert np.flatnonzero(~found[1].any(axis=1)).tolist() == [0, 49, 50, 99]


def test_late_gyros_say_dw_dt_of_their_own_time() -> None:
    """Readings of 3 ms after the stamp: ω(t + 3 ms) is what they have, dω/dt(t) what is wanted."""
    t = np.arange(400) * 0.01
    made = moved(t, 1.0, (1e-9, 1e-9), np.random.default_rng(0))
    late = np.tile(3e-3 * np.eye(3), (400, 2, 1, 1))
    found = spin_by_neighbours(t, made, late)
    assert found is not None
    w = 2.0 * np.pi
    np.testing.assert_allclose(found[0][1:-1, 0], w * np.cos(w * t)[1:-1], atol=1e-2)


def test_the_nearest_instants_are_side_by_side() -> None:
    t, own = np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.1, 0.9, 2.4, 3.0])
    values = np.arange(4.0)[:, None] * np.ones(3)
    near = side_by_side._nearest(t, own, values, 0.3)
    np.testing.assert_array_equal(near[:, 0], [0.0, 1.0, np.nan, 3.0])
    tied = side_by_side._nearest(np.array([0.5]), np.array([0.0, 1.0]), values, 0.5)
    assert tied[0, 0] == 0.0
    assert np.isnan(side_by_side._nearest(t, own[:0], values[:0], 0.3)).all()
    one = side_by_side._nearest(t, own[:1], values[:1] + 5.0, 0.3)
    np.testing.assert_array_equal(one[:, 0], [5.0, np.nan, np.nan, np.nan])


def test_noise_of_a_log_replaces_that_of_the_calibration_where_it_is_measured() -> None:
    rests = SimpleNamespace(
        noise=np.array([[1.0, 2.0, np.nan], [0.0, 4.0, 5.0]]),
        rate_noise=np.array([[0.1, 0.2, 0.3], [np.nan] * 3]),
    )
    force, rate = survey._noise_at_rest(
        rests,
        {0: 1, 1: 0},
        (np.full((2, 3), 9.0), np.full((2, 3), 0.9)),  # type: ignore[arg-type]
    )
    assert force.tolist() == [[9.0, 4.0, 5.0], [1.0, 2.0, 9.0]]
    assert rate.tolist() == [[0.9] * 3, [0.1, 0.2, 0.3]]
