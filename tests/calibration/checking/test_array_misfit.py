"""The rests of an array's IMU, written a second time, and its gyroscope."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.checking.check import Measured, checked
from imucalib.calibration.checking.limits import Limits
from imucalib.calibration.checking.misfit import check_noise, gyro_rest, triad_misfits
from imucalib.calibration.triads import Triad
from worlds.instrument import DEG, MG, G, four, rotation, vectors

ROTATION = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def imu(rng: np.random.Generator) -> Triad:
    gain = np.eye(3) + 0.005 * rng.standard_normal((3, 3))
    root = np.diag([2e-4] * 9 + [0.2 * MG] * 3) @ (np.eye(12) + 0.2 * rng.standard_normal((12, 12)))
    return Triad("imu0", ROTATION, gain, 0.1 * rng.standard_normal(3), np.eye(3),
                 0.5 * DEG * rng.standard_normal(3), root @ root.T, 0.03, 0.002)  # fmt: skip


def board(triad: Triad) -> Calibration:
    """Twelve rests of two IMUs that scatter by 0.25 mg."""
    return Calibration(
        "array", (), np.zeros((0, 0)), "m/s2", 1.0, G, "ok",
        facts={"rests": {"count": 12, "residual_m_per_s2": 0.25 * MG}},
        triads=(triad, replace(triad, name="imu1")),
    )  # fmt: skip


def test_the_imu_that_changed_is_named() -> None:
    rng = np.random.default_rng(2)
    triad = imu(rng)
    force = np.concatenate([vectors(*four(rng)) for _ in range(3)])
    clean = (force @ triad.gain.T + triad.bias) @ ROTATION
    calibration = board(triad)
    noise = check_noise(calibration)
    measured = []
    for k, shift in enumerate((0.0, 2.5)):
        reading = clean + 0.25 * MG * rng.standard_normal(clean.shape) + [shift * MG, 0.0, 0.0]
        misfits = triad_misfits(calibration, triad, reading, noise, np.zeros(12))
        measured.append(Measured(misfits, f"imu{k}"))
    found = checked(calibration, measured, noise, Limits())
    assert found.verdict == "changed"
    assert [s.name for s in found.changed] == ["imu1"]
    # A package's +x is the board's -y.
    assert found.sensors[1].tests["bias"].size == pytest.approx([0.0, -2.5, 0.0], abs=1.0)


def test_a_gyroscope_at_rest() -> None:
    rng = np.random.default_rng(3)
    triad = imu(rng)
    turned = triad.gyro_bias + rotation(np.zeros(3))[0] * 0.2 * DEG
    rate = (turned + 0.01 * DEG * rng.standard_normal((6, 3))) @ ROTATION
    found = gyro_rest(triad, rate, {"count": 12})
    assert found is not None
    assert found.bias == pytest.approx([0.2, 0.0, 0.0], abs=0.02)
    assert found.sd == pytest.approx(0.01 * np.sqrt(1 / 6 + 1 / 12), rel=0.7)
    assert found.p < 1e-3
    assert gyro_rest(triad, np.full((6, 3), np.nan), {}) is None
