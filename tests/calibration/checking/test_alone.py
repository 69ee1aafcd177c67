"""One reading that is wrong among good ones is told from a change of the sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.checking.array_misfit import triad_misfits
from imucalib.calibration.checking.check import Check, Measured, checked
from imucalib.calibration.checking.limits import Limits
from imucalib.calibration.checking.noise import check_noise
from imucalib.calibration.triads import Triad
from worlds.instrument import DEG, MG, G


def looked_at(rests: int, shift: np.ndarray) -> Check:
    """Rests of one IMU, noise 0.25 mg; shift : (rests, 3) mg beside what was calibrated."""
    rng = np.random.default_rng(rests)
    root = np.diag([2e-4] * 9 + [0.2 * MG] * 3)
    triad = Triad("imu0", np.eye(3), np.eye(3), np.zeros(3), np.eye(3), np.zeros(3), root @ root.T,
                  0.03, 0.1 * DEG)  # fmt: skip
    calibration = Calibration(
        "array", (), np.zeros((0, 0)), "m/s2", 1.0, G, "ok",
        facts={"rests": {"count": 24, "residual_m_per_s2": 0.25 * MG}},
        triads=(triad, replace(triad, name="imu1")),
    )  # fmt: skip
    force = rng.normal(size=(rests, 3))
    force *= G / np.linalg.norm(force, axis=1, keepdims=True)
    along = force / G
    reading = force + MG * shift * along + 0.25 * MG * rng.standard_normal(force.shape)
    noise = check_noise(calibration)
    misfits = triad_misfits(calibration, triad, reading, noise, np.zeros(rests))
    return checked(calibration, [Measured(misfits, "imu0")], noise, Limits())


def wrong_in(rests: int, *rows: int) -> np.ndarray:
    """40 mg along gravity in some rows, of either sign by turns."""
    out = np.zeros((rests, 3))
    for k, row in enumerate(rows):
        out[row] = 40.0 * (-1) ** k
    return out


@pytest.mark.parametrize(("rests", "row"), [(16, 3), (16, 15), (8, 5)])
def test_the_one_reading_that_is_off_is_named(rests: int, row: int) -> None:
    found = looked_at(rests, wrong_in(rests, row))
    assert found.verdict == "undecided"  # the sensor may be as it was
    assert (found.sensors[0].causes, found.sensors[0].alone) == ((), row)


@pytest.mark.parametrize(
    ("rests", "rows"), [(16, ()), (16, (3, 9)), (7, (5,))], ids=["none", "two", "too few"]
)
def test_no_reading_is_set_apart(rests: int, rows: tuple[int, ...]) -> None:
    """Where nothing shows, where one does not explain it, and where one of few may be all that sees
    a change: eight are needed."""
    found = looked_at(rests, wrong_in(rests, *rows))
    assert (found.verdict == "changed") == bool(rows)
    assert found.sensors[0].alone is None


def test_a_change_that_explains_all_rows_is_no_wrong_reading() -> None:
    """A scale that is off by 20 mg/g along every axis."""
    found = looked_at(16, np.full((16, 3), 20.0))
    assert "scale" in found.sensors[0].causes
    assert found.sensors[0].alone is None
