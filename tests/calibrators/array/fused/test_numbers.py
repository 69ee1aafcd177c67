"""What a fused log is weighed by, each number against the same written a second time: biases that
walk, noise that grows, dω/dt from neighbours, instants side by side."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.calibrators.array.fused.fuse import spin_by_neighbours
from imucalib.calibrators.array.fused.instrument import Biases
from imucalib.calibrators.array.fused.noise import ChipNoise, fitted_noise
from imucalib.estimators.array.fusion import FusedMotion

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


def test_neighbours_are_not_believed_of_a_fast_motion() -> None:
    """The error of a central difference: (2π f)³ Δt² / 6, rms of the tone."""
    t = np.arange(400) * 0.01
    made = moved(t, 8.0, (1.0, 1e-6), np.random.default_rng(0))
    found = spin_by_neighbours(t, made, None)
    assert found is not None
    error = (2.0 * np.pi * 8.0) ** 3 * 1e-4 / 6.0 / np.sqrt(2.0)
    assert 1.0 / np.sqrt(np.median(found[1][10:-10])) == pytest.approx(error, rel=0.25)


def test_late_gyros_say_dw_dt_of_their_own_time() -> None:
    """Readings of 3 ms after the stamp: ω(t + 3 ms) is what they have, dω/dt(t) what is wanted."""
    t = np.arange(400) * 0.01
    made = moved(t, 1.0, (1e-9, 1e-9), np.random.default_rng(0))
    late = np.tile(3e-3 * np.eye(3), (400, 2, 1, 1))
    found = spin_by_neighbours(t, made, late)
    assert found is not None
    w = 2.0 * np.pi
    np.testing.assert_allclose(found[0][1:-1, 0], w * np.cos(w * t)[1:-1], atol=1e-2)
