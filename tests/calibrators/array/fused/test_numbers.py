"""Numbers behind the fused IMU, by hand."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from imucalib.calibrators.array.fused.fuse import spin_by_neighbours
from imucalib.calibrators.array.fused.instrument import Beyond, Biases, beyond_linear
from imucalib.calibrators.array.fused.noise import ChipNoise, at_rest, fitted_noise
from imucalib.calibrators.array.loop.motion import board_motion
from imucalib.estimators.array.fusion import FusedMotion
from imucalib.units import DEG, MG, STANDARD_GRAVITY

Array = NDArray[np.float64]


def test_biases_run_straight_between_rests() -> None:
    own = Biases(np.zeros((1, 3)), np.array([10.0, 20.0, 40.0]),
                 np.array([1.0, 3.0, -1.0])[:, None, None] * np.ones((3, 1, 3)))  # fmt: skip
    at = np.array([0.0, 10.0, 15.0, 20.0, 25.0, 40.0, 90.0])
    np.testing.assert_allclose(own.rate_at(at)[:, 0, 0], [1.0, 1.0, 2.0, 3.0, 2.0, -1.0, -1.0])


def test_a_triad_far_out_loses_its_say() -> None:
    """Student's t of ν: (ν + d) / (ν + square); a Gaussian's from thirty sigmas square on."""
    live, square = np.array([[3.0, 2.0]]), np.array([[1.0, 60.0]])
    tails = ChipNoise(np.ones((2, 3)), np.zeros(2), 4.0).share(square, live)
    np.testing.assert_allclose(tails, [[7.0 / 5.0, 6.0 / 64.0]])
    plain = ChipNoise(np.ones((2, 3)), np.zeros(2), np.inf).share(square, live)
    np.testing.assert_allclose(plain, [[1.0, 0.25]])


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


def test_late_gyros_say_dw_dt_of_their_own_time() -> None:
    """Readings of 3 ms after the stamp: ω(t + 3 ms) is what they have, dω/dt(t) what is wanted."""
    t = np.arange(400) * 0.01
    made = moved(t, 1.0, (1e-9, 1e-9), np.random.default_rng(0))
    late = np.tile(3e-3 * np.eye(3), (400, 2, 1, 1))
    found = spin_by_neighbours(t, made, late)
    assert found is not None
    w = 2.0 * np.pi
    np.testing.assert_allclose(found[0][1:-1, 0], w * np.cos(w * t)[1:-1], atol=1e-2)


T, K = 700, 3


def residuals(
    growth: float, freedom: float, seed: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Residuals (T, K, 3), speeds, noise at rest, and the share that the motion leaves."""
    rng = np.random.default_rng(seed)
    rest, speed = np.array([[0.04] * 3, [0.05] * 3, [0.03] * 3]), rng.uniform(2.0, 15.0, T)
    left = rng.uniform(0.5, 0.9, (T, K))
    sd = np.sqrt(rest**2 + (speed[:, None, None] * growth) ** 2)
    heavy = np.sqrt(freedom / rng.chisquare(freedom, (T, K, 1))) if np.isfinite(freedom) else 1.0
    off = sd * heavy * rng.standard_normal((T, K, 3)) * np.sqrt(left)[..., None]
    return off, speed, rest, left


def density(noise: ChipNoise, off: np.ndarray, speed: np.ndarray, left: np.ndarray) -> float:
    """Of all triads: a multivariate t, or a Gaussian, at residuals over the share left."""
    total = 0.0
    for t in range(0, T, 50):
        for k in range(K):
            variance = noise.rest[k] ** 2 + (speed[t] * noise.growth[k]) ** 2
            x, shape = off[t, k] / np.sqrt(left[t, k]), np.diag(variance)
            whole = (
                stats.multivariate_t(np.zeros(3), shape, df=noise.freedom)
                if np.isfinite(noise.freedom)
                else stats.multivariate_normal(np.zeros(3), shape)
            )
            total += whole.logpdf(x)
    return total


@pytest.mark.parametrize(("growth", "freedom"), [(0.02, 4.0), (0.02, np.inf), (0.005, 6.0)])
def test_the_growth_and_the_tails_come_back(growth: float, freedom: float) -> None:
    off, speed, rest, left = residuals(growth, freedom)
    live = np.ones(off.shape, bool)
    found = fitted_noise(off, live, left, speed, rest)
    assert found.growth == pytest.approx(np.full(K, growth), rel=0.25)
    assert (found.freedom > 20.0) == np.isinf(freedom)
    if np.isfinite(freedom):
        assert 0.6 < found.freedom / freedom < 1.7
    # No less likely than what is true, and more than without growth or with twice the growth.
    best = density(found, off, speed, left)
    assert best > density(ChipNoise(rest, np.full(K, growth), freedom), off, speed, left) - 3.0
    assert best > density(ChipNoise(rest, 2.0 * found.growth, found.freedom), off, speed, left)
    assert best > density(ChipNoise(rest, 0.5 * found.growth, found.freedom), off, speed, left)


def test_what_a_sample_weighs_and_its_widening() -> None:
    heavy = ChipNoise(np.ones((2, 3)), np.array([0.5, 0.0]), 4.0)
    np.testing.assert_allclose(heavy.variance(np.array([0.0, 4.0])),
                               [[[1.0] * 3, [1.0] * 3], [[5.0] * 3, [1.0] * 3]])  # fmt: skip
    square, live = np.array([[0.0, 3.0]]), np.array([[3.0, 2.0]])
    np.testing.assert_allclose(heavy.share(square, live), [[7.0 / 4.0, 6.0 / 7.0]])
    assert heavy.widening == pytest.approx(9.0 / 7.0)
    assert at_rest(np.ones((2, 3))).widening == 1.0


QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


TURN = np.array([np.eye(3), QUARTER])


BEYOND_T = 6


RNG = np.random.default_rng(8)


RATE, SPIN = 5.0 * RNG.normal(size=(BEYOND_T, 3)), 100.0 * RNG.normal(size=(BEYOND_T, 3))


FORCE = 12.0 * RNG.normal(size=(BEYOND_T, 2, 3))


AGE = RNG.uniform(-0.5, 0.5, (BEYOND_T, 2))


def block(effect: str, *values: float) -> dict[str, Any]:
    return {"effect": effect, "parameters": [{"value": v} for v in values]}


def beyond(*blocks: dict[str, Any]) -> Beyond:
    triads = [SimpleNamespace(name=n, rotation=r) for n, r in zip("ab", TURN, strict=True)]
    return beyond_linear(SimpleNamespace(triads=triads, facts={"effects": blocks}))  # type: ignore[arg-type]


def added(made: Beyond) -> tuple[np.ndarray, np.ndarray]:
    motion = board_motion(
        imus=made.imus, rotations=TURN, t=np.arange(float(BEYOND_T)), order=np.full(BEYOND_T, 0.5),
        rate=RATE,
        spin=SPIN, force=FORCE, jerk=FORCE, age=AGE,
    )  # fmt: skip
    return made.added(motion)


def test_a_delay_is_late_by_itself_and_a_gain_undoes_its_share() -> None:
    t = np.arange(4.0)
    made = beyond(block("gyro_delay", 0.7))
    assert made.span == 0.0
    np.testing.assert_allclose(made.late(t, None), np.tile(-0.7e-3 * np.eye(3), (4, 2, 1, 1)))
    assert not np.any(added(made))
    # One gyro's by itself, read through its scale of 2, 0 and -1 % along its own axes.
    both = beyond(block("gyro_delay_each@b", 0.4), block("gyro_scale@b", 2.0, 0.0, -1.0))
    late = both.late(t, None)
    assert late is not None
    assert not np.any(late[:, 0])
    scale = QUARTER @ np.diag([1.02, 1.0, 0.99]) @ QUARTER.T
    np.testing.assert_allclose(late[0, 1], -0.4e-3 * np.linalg.inv(scale), atol=1e-9)
    assert beyond(block("gyro_scale", *[1.0] * 6)).late(t, None) is None


def test_what_bends_is_added_and_what_is_linear_is_not() -> None:
    curved = beyond(block("gyro_quadratic@a", 3.0, 0.0, -2.0), block("quadratic@b", 1.5, 0.0, 4.0))
    force, rate = added(curved)
    own = RATE / (2000.0 * DEG)
    expected = DEG * own**2 * [3.0, 0.0, -2.0]
    np.testing.assert_allclose(rate[:, 0], expected, atol=1e-6)
    assert not np.any(rate[:, 1])
    assert not np.any(force[:, 0])
    own = FORCE[:, 1] @ QUARTER / STANDARD_GRAVITY
    in_board = MG * (own**2 * [1.5, 0.0, 4.0]) @ QUARTER.T
    np.testing.assert_allclose(force[:, 1], in_board, atol=1e-6)
    for linear in (block("gyro_scale", *[1.0] * 6), block("gyro_bias", *[2.0] * 6)):
        assert beyond(linear).parts == ()


@pytest.mark.parametrize(
    ("name", "answer"),
    [("gyro_low_pass", lambda x: 1.0 / (1.0 + x)), ("gyro_delay", lambda x: np.exp(-x))],
)
def test_lags_over_time_are_not_those_of_the_first_order(
    name: str, answer: Callable[[complex], complex]
) -> None:
    """A tone of 4 Hz, 4 ms: the second order is 1 % of it, and half of that for a delay."""
    t, pace = 0.01 * np.arange(400), 2.0j * np.pi * 4.0
    tone = np.exp(pace * t)[:, None] * np.array([12.0, 0.0, 5.0])
    zero = np.zeros((400, 2, 3))
    beside = np.stack([np.arange(400) > 0, np.arange(400) < 399], axis=1)
    motion = board_motion(
        imus=("a", "b"), rotations=TURN, t=t, order=np.full(400, 0.5), rate=tone.imag,
        spin=(pace * tone).imag, force=zero, jerk=zero,
    ).coursed(beside)  # fmt: skip
    made = beyond(block(name, 4.0))
    late = made.late(t, None)
    assert late is not None
    read = (answer(4e-3 * pace) * tone).imag[:, None]
    first = tone.imag[:, None] + np.matmul(late, (pace * tone).imag[:, None, :, None])[..., 0]
    inner = slice(20, -20)
    assert np.abs(first - read)[inner].max() > 0.05
    assert np.abs(first + made.added_by_lags(motion)[1] - read)[inner].max() < 0.004
