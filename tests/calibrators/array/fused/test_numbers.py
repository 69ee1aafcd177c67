"""Numbers behind the fused IMU, by hand."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from imucalib.arrays import Array
from imucalib.calibrators.array.fused.instrument import Beyond, beyond_linear
from imucalib.calibrators.array.fused.noise import ChipNoise, fitted_noise
from imucalib.calibrators.array.loop.motion import board_motion
from imucalib.units import DEG, MG, STANDARD_GRAVITY

T, K = 700, 3


def density(noise: ChipNoise, off: Array, speed: Array, left: Array) -> float:
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


@pytest.mark.parametrize(
    ("growth", "freedom"),
    [(0.02, 4.0), (0.02, np.inf), (0.005, 6.0), (np.array([0.02, 0.02, 0.036]), np.inf)],
)
def test_the_growth_and_the_tails_come_back(growth: Any, freedom: float) -> None:
    rng = np.random.default_rng(0)
    rest, speed = np.array([[0.04] * 3, [0.05] * 3, [0.03] * 3]), rng.uniform(2.0, 15.0, T)
    left, true = rng.uniform(0.5, 0.9, (T, K)), np.broadcast_to(growth, K)
    sd = np.sqrt(rest**2 + (speed[:, None, None] * true[:, None]) ** 2)
    heavy = np.sqrt(freedom / rng.chisquare(freedom, (T, K, 1))) if np.isfinite(freedom) else 1.0
    off = sd * heavy * rng.standard_normal((T, K, 3)) * np.sqrt(left)[..., None]
    found = fitted_noise(off, np.ones(off.shape, bool), left, speed, rest)
    assert found.growth == pytest.approx(true, rel=0.25)
    if np.ndim(growth) == 0:  # with unlike chips it begins with one growth for all, and tails
        assert (found.freedom > 20.0) == np.isinf(freedom)
    if np.isfinite(freedom):
        assert 0.6 < found.freedom / freedom < 1.7
    # No less likely than what is true, and more than with twice or half of the growth.
    best = density(found, off, speed, left)
    assert best > density(ChipNoise(rest, true, freedom), off, speed, left) - 3.0
    for times in (0.5, 2.0):
        other = ChipNoise(rest, times * found.growth, found.freedom)
        assert best > density(other, off, speed, left)


QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
TURN = np.array([np.eye(3), QUARTER])
RNG = np.random.default_rng(8)
RATE, SPIN = 5.0 * RNG.normal(size=(6, 3)), 100.0 * RNG.normal(size=(6, 3))
FORCE = 12.0 * RNG.normal(size=(6, 2, 3))


def block(effect: str, *values: float) -> dict[str, Any]:
    return {"effect": effect, "parameters": [{"value": v} for v in values]}


def beyond(*blocks: dict[str, Any]) -> Beyond:
    triads = [SimpleNamespace(name=n, rotation=r) for n, r in zip("ab", TURN, strict=True)]
    return beyond_linear(SimpleNamespace(triads=triads, facts={"effects": blocks}))  # type: ignore[arg-type]


def added(made: Beyond) -> tuple[Array, Array]:
    t = np.arange(6.0)
    return made.added(
        board_motion(imus=made.imus, rotations=TURN, t=t, rate=RATE, spin=SPIN, force=FORCE)
    )


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
    np.testing.assert_allclose(rate[:, 0], DEG * own**2 * [3.0, 0.0, -2.0], atol=1e-6)
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
    beside = np.stack([np.arange(400) > 0, np.arange(400) < 399], axis=1)
    motion = board_motion(
        imus=("a", "b"), rotations=TURN, t=t, rate=tone.imag, spin=(pace * tone).imag
    ).coursed(beside)
    made = beyond(block(name, 4.0))
    late = made.late(t, None)
    assert late is not None
    read = (answer(4e-3 * pace) * tone).imag[:, None]
    first = tone.imag[:, None] + np.matmul(late, (pace * tone).imag[:, None, :, None])[..., 0]
    inner = slice(20, -20)
    assert np.abs(first - read)[inner].max() > 0.05
    assert np.abs(first + made.added_by_lags(motion)[1] - read)[inner].max() < 0.004
