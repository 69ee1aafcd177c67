"""Curves without a name are the cosines that their equations print."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.calibrators.array.loop.curves import array_curves, wander
from imucalib.calibrators.array.loop.motion import BoardMotion, board_motion
from imucalib.core.effect import Response
from imucalib.units import DEG

T, IMUS = 7, ("a", "b")
TURN = np.array([np.eye(3), [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]])
RNG = np.random.default_rng(5)
RATE, SPIN = 4.0 * RNG.normal(size=(T, 3)), 90.0 * RNG.normal(size=(T, 3))
FORCE = 10.0 * RNG.normal(size=(T, 2, 3))
OWN_FORCE = np.einsum("kji,tkj->tki", TURN, FORCE)
OWN_RATE, OWN_SPIN = (np.einsum("kji,tj->tki", TURN, v) for v in (RATE, SPIN))
ORDER = np.linspace(0.0, 1.0, T)


def motion() -> BoardMotion:
    return board_motion(
        imus=IMUS, rotations=TURN, t=np.arange(float(T)), order=ORDER, rate=RATE, spin=SPIN,
        force=FORCE, jerk=FORCE,
    )  # fmt: skip


def curve(name: str) -> Response:
    (found,) = [one for _, one in array_curves(motion()) if one.name == name]
    return found


def waves(v: np.ndarray, count: int) -> np.ndarray:
    u = (v - v.min()) / (v.max() - v.min())
    return np.stack([np.sqrt(2.0) * np.cos(np.pi * k * u) / k for k in range(1, count + 1)], -1)


def test_there_are_eight_drivers_and_two_that_wander() -> None:
    assert [driver for driver, _ in array_curves(motion())] == [
        "|ω|", "|a|", "time", "a", "|ω|", "|a|", "time", "ω", "", "",
    ]  # fmt: skip
    alone = [one.name for _, one in array_curves(motion()) if not one.shared]
    assert alone == [
        "accelerometer error against time", "gyroscope error against time",
        "position of {imu} against time", "gyro delay of {imu} against time",
    ]  # fmt: skip


@pytest.mark.parametrize(("sensor", "unit", "size"), [("accelerometer", 1.0, 0.1),
                                                      ("gyroscope", DEG, 0.3)])  # fmt: skip
def test_an_error_of_each_axis_follows_its_driver(sensor: str, unit: float, size: float) -> None:
    whole = {
        "|ω|": np.linalg.norm(OWN_RATE, axis=2),
        "|a|": np.linalg.norm(OWN_FORCE, axis=2),
        "time": np.tile(ORDER[:, None], (1, 2)),
    }
    seen = motion()
    for words, v in whole.items():
        one = curve(f"{sensor} error against {words}")
        expected = np.zeros((T, 2, 3, 12))
        for axis in range(3):
            expected[:, :, axis, 4 * axis : 4 * axis + 4] = unit * waves(v, 4)
        np.testing.assert_allclose(one.basis(seen.truth, seen.context), expected, atol=1e-12)
        assert [p.name for p in one.each] == [f"{a}_{k}" for a in "xyz" for k in (1, 2, 3, 4)]
        assert {p.typical for p in one.each} == {size}
    own = OWN_FORCE if sensor == "accelerometer" else OWN_RATE
    one = curve(f"{sensor} error against its own {'a' if sensor == 'accelerometer' else 'ω'}")
    expected = np.zeros((T, 2, 3, 12))
    every = waves(own, 4)
    for axis in range(3):
        expected[:, :, axis, 4 * axis : 4 * axis + 4] = unit * every[:, :, axis]
    np.testing.assert_allclose(one.basis(seen.truth, seen.context), expected, atol=1e-12)


def test_a_place_that_wanders_is_felt_as_a_lever() -> None:
    one, seen = curve("position of {imu} against time"), motion()
    theta = RNG.normal(size=6)
    moved = 1e-3 * np.einsum("ik,tk->ti", theta.reshape(3, 2), waves(ORDER, 2))  # m, in the board
    felt = np.cross(SPIN, moved) + np.cross(RATE, np.cross(RATE, moved))
    expected = np.einsum("kji,tj->tki", TURN, felt)
    np.testing.assert_allclose(one.basis(seen.truth, seen.context) @ theta, expected, atol=1e-12)
    assert [p.typical for p in one.each] == [0.05] * 6


def test_a_clock_that_wanders_reads_the_rate_of_before() -> None:
    one, seen = curve("gyro delay of {imu} against time"), motion()
    theta = np.array([0.4, -0.7])  # ms
    late = 1e-3 * waves(ORDER, 2) @ theta
    expected = -late[:, None, None] * OWN_SPIN
    np.testing.assert_allclose(one.basis(seen.truth, seen.context) @ theta, expected, atol=1e-12)
    assert [p.typical for p in one.each] == [0.05] * 2


def test_how_far_an_imu_wanders() -> None:
    """The rms over the motion of what the equation prints."""
    place, theta = curve("position of {imu} against time"), RNG.normal(size=6)
    sizes = 1e-3 * theta * [p.typical for p in place.each]
    u = np.linspace(0.0, 1.0, 100_001)
    away = sizes.reshape(3, 2) @ np.stack(
        [np.sqrt(2.0) * np.cos(np.pi * k * u) / k for k in (1, 2)]
    )
    assert wander(place, theta) == pytest.approx(
        np.sqrt(np.mean(np.sum(away**2, axis=0))), rel=1e-4
    )
    assert wander(curve("gyro delay of {imu} against time"), theta[:2]) == 0.0
