"""A calibrated sensor as it acts: the force of a reading, and how it moves with the parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibration.calibration import Calibration, StoredParameter
from imucalib.calibration.comparison.basis import ArrayImu, sensor_of
from imucalib.calibration.triads import Triad
from worlds.instrument import MG, Array, G, rotation


def forces(n: int = 5) -> Array:
    found = np.random.default_rng(2).normal(size=(n, 3))
    return G * found / np.linalg.norm(found, axis=1, keepdims=True)


def imu() -> Triad:
    rng = np.random.default_rng(3)
    return Triad("imu0", np.eye(3), np.eye(3) + 0.1 * rng.normal(size=(3, 3)), rng.normal(size=3),
                 np.eye(3), np.zeros(3), np.diag(np.arange(1.0, 13.0)), 0.03, 0.1)  # fmt: skip


def test_an_imu_reads_its_gain_times_the_force_and_its_bias() -> None:
    triad, force = imu(), forces()
    one = ArrayImu(triad)
    expected = np.stack([triad.gain @ f + triad.bias for f in force])
    np.testing.assert_allclose(one.reading(force), expected, rtol=1e-13)
    np.testing.assert_allclose(one.force(expected), force, rtol=1e-12)
    assert one.covariance is triad.covariance


def test_how_the_force_of_an_imu_moves_with_gain_and_bias() -> None:
    """Nine of the gain, row by row, and three of the bias; central differences."""
    triad, force = imu(), forces()
    reading, slope = ArrayImu(triad).reading(force), ArrayImu(triad).slope(force)
    assert slope.shape == (5, 3, 12)
    for k, step in enumerate(1e-6 * np.eye(12)):
        up, down = (
            ArrayImu(replace(triad, gain=triad.gain + s[:9].reshape(3, 3), bias=triad.bias + s[9:]))
            for s in (step, -step)
        )
        numeric = (up.force(reading) - down.force(reading)) / 2e-6
        np.testing.assert_allclose(slope[:, :, k], numeric, rtol=1e-6, atol=1e-8)


#: bias in mg, scale in 1, mounting in deg.
THETA = np.array([12.0, -7.0, 20.0, 0.01, -0.02, 0.005, 0.5, -1.0, 2.0])


def stored(theta: Array) -> Calibration:
    kinds = (("bias", "mg", "sensor"), ("scale", "1", "sensor"), ("mounting", "deg", "mounting"))
    parameters = [
        StoredParameter(f"{kind}_{a}", kind, stage, float(theta[3 * k + j]), 0.1, unit)
        for k, (kind, unit, stage) in enumerate(kinds)
        for j, a in enumerate("xyz")
    ]
    return Calibration("lab", tuple(parameters), np.diag(np.arange(1.0, 10.0)), "g", 9.80665, G,
                       "ok")  # fmt: skip


def test_one_sensor_reads_what_its_effects_say() -> None:
    """Turned into the sensor's axes, scaled, and offset."""
    one, force = sensor_of(stored(THETA)), forces()
    inside = force @ rotation(THETA[6:]).T
    expected = inside * (1.0 + THETA[3:6]) + MG * THETA[:3]
    np.testing.assert_allclose(one.reading(force), expected, rtol=1e-12)
    np.testing.assert_allclose(one.force(expected), force, rtol=1e-11)
    # Parameters stand in the order in which they act: the mounting first.
    assert one.part.at.tolist() == [6, 7, 8, 0, 1, 2, 3, 4, 5]
    np.testing.assert_array_equal(one.covariance, np.diag(1.0 + one.part.at))


@pytest.mark.parametrize("of", ["force", "reading"])
def test_how_one_sensor_moves_with_its_parameters(of: str) -> None:
    one, force = sensor_of(stored(THETA)), forces()
    reading = one.reading(force)
    slope = one.slope(force) if of == "force" else one.reading_slope(force)
    for k, step in enumerate(1e-5 * np.eye(9)[one.part.at]):
        up, down = (sensor_of(stored(THETA + s)) for s in (step, -step))
        ends = (
            (up.force(reading), down.force(reading))
            if of == "force"
            else (up.reading(force), down.reading(force))
        )
        np.testing.assert_allclose(slope[:, :, k], (ends[0] - ends[1]) / 2e-5, rtol=1e-5, atol=1e-9)
