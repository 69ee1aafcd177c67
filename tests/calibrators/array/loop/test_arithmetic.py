"""Arithmetic of the array's search: clocks and late readings."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.calibrators.array.loop.catalogue import array_catalogue
from imucalib.calibrators.array.loop.motion import BoardMotion, board_motion
from imucalib.calibrators.array.loop.terms import Term, columns_of, determined, lost, sensed


def swung(t: Array) -> BoardMotion:
    """All packages alike: ω and the force swing at 4 and 3 Hz."""
    w, f = 8.0 * np.pi, 6.0 * np.pi
    rate, force = (np.sin(x * t)[:, None] * [1.0, -2.0, 0.5] for x in (w, f))
    spin, jerk = (x * np.cos(x * t)[:, None] * [1.0, -2.0, 0.5] for x in (w, f))
    every = (len(t), 2, 3)
    found = board_motion(
        imus=("imu0", "imu1"), rotations=np.tile(np.eye(3), (2, 1, 1)), t=t, order=t, rate=rate,
        spin=spin, force=np.broadcast_to(force[:, None], every),
        jerk=np.broadcast_to(jerk[:, None], every),
    )  # fmt: skip
    beside = np.ones((len(t), 2), dtype=np.bool_)
    beside[0, 0] = beside[-1, 1] = False
    return found.coursed(beside)


def term(name: str, delay: list[float]) -> Term:
    return Term(name, array_catalogue()[name], None, np.eye(len(delay)), np.array(delay),
                np.ones(len(delay)))  # fmt: skip


T = np.arange(200) / 200.0


def test_what_acts_on_a_late_reading_acts_on_what_was_then() -> None:
    here, late = swung(T), [0.0, 1.5]
    own, other = term("gyro_delay_each", late), term("accelerometer_delay", [0.5, 0.0])
    np.testing.assert_allclose(own.lag(here)[0], [0.0, 1.5e-3], atol=1e-15)
    np.testing.assert_allclose(other.lag(here)[0], [0.5e-3, 0.0], atol=1e-15)
    then = sensed([own, other], here)
    earlier = swung(T - 1.5e-3).truth.turning.rate[:, 1]
    # The third order is left: (8 π 1.5e-3)³ / 6 of the swing.
    turning = then.truth_of("angular_rate").turning.rate
    # Of the first and the last only what lies to one side is known.
    np.testing.assert_allclose(turning[1:-1, 1], earlier[1:-1], atol=2e-5)
    np.testing.assert_allclose(turning[:, 0], here.truth.turning.rate[:, 0], atol=1e-15)
    felt = then.truth_of("acceleration").force
    due = swung(T - 0.5e-3).truth.force[:, 0]
    np.testing.assert_allclose(felt[1:-1, 0], due[1:-1], atol=1e-6)
    less = lost([own, other], here)
    np.testing.assert_allclose(here.truth.turning.rate - less[1], turning, atol=1e-12)
    np.testing.assert_allclose(here.truth.force - less[0], felt, atol=1e-12)
    scale = columns_of(array_catalogue()["gyro_scale"], then).basis[1]
    np.testing.assert_allclose(np.einsum("tii->ti", scale)[1:-1], 0.01 * earlier[1:-1], atol=2e-7)


@pytest.mark.parametrize("tau", [0.6, 4.0, 16.0])
def test_a_low_pass_weakens_what_is_fast(tau: float) -> None:
    """Against H = 1 / (1 + i ω τ) of each swing; the first samples have no past to be filtered."""
    here = swung(T)
    slow = [term("gyro_low_pass_each", [0.0, tau]), term("accelerometer_low_pass", [tau, 0.0])]
    then = sensed(slow, here)
    rate, force = then.truth_of("angular_rate").turning.rate, then.truth_of("acceleration").force
    for found, hz in ((rate[:, 1], 4.0), (force[:, 0], 3.0)):
        w = 2.0 * np.pi * hz
        y = np.imag(np.exp(1j * w * T) / (1.0 + 1e-3j * w * tau))
        late = T > 0.1
        np.testing.assert_allclose(found[late, 1], -2.0 * y[late], atol=2e-4)
    np.testing.assert_allclose(rate[:, 0], here.truth.turning.rate[:, 0], atol=1e-15)
    np.testing.assert_allclose(force[:, 1], here.truth.force[:, 1], atol=1e-15)


@pytest.mark.parametrize(
    ("name", "beside", "rank"),
    [
        ("gyro_delay_each", "accelerometer_delay", 1),
        ("gyro_delay_each", "accelerometer_low_pass", 1),
        ("gyro_delay_each", "gyro_scale", 2),
        ("accelerometer_delay", "gyro_delay", 1),
        ("accelerometer_delay", "gyro_sample_age", 2),
    ],
)
def test_the_time_itself_is_nobodys(name: str, beside: str, rank: int) -> None:
    """What all delays of both kinds of sensor share is no delay at all; a clock's beat has none."""
    other = term(beside, [0.0, 0.0])
    found = determined(name, array_catalogue()[name], None, 1e4 * np.eye(2), [other])
    assert found.live.shape[1] == rank
    if rank == 1:
        assert abs(found.live.sum()) < 1e-12
