"""What time has brought about stays: a bench's jump or drift, in a recording made after it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.calibration.apply import apply_to_recording
from imucalib.calibration.calibration import Calibration
from imucalib.calibrators.lab.calibrate import LabSettings
from imucalib.calibrators.lab.position_table import read_position_table
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import run_lab
from imucalib.exports.linear import nearest_linear
from imucalib.recording.recording import Channel, Recording
from imucalib.units import MG
from worlds.sheets import Sheet, direction

Array = NDArray[np.float64]
BIAS, CHANGE = np.array([12.0, -7.0, 5.0]), np.array([4.0, -3.0, 6.0])


def calibrated(declared: str, course: Array, folder: Path) -> Calibration:
    """A sheet of 36 rows whose bias changes along a course (36,) from 0 to 1."""
    rng = np.random.default_rng(3)
    i, t = np.repeat([-60.0, -20.0, 20.0, 60.0], 9), np.tile(np.arange(0.0, 360.0, 40.0), 4)
    shuffled = rng.permutation(36)
    i, t = i[shuffled], t[shuffled]
    reading = 1000.0 * direction(i, t) + BIAS + course[:, None] * CHANGE
    reading = reading + 0.05 * rng.standard_normal((36, 3))
    path = Sheet(i, t, reading).write(folder / "sheet.csv")
    settings = LabSettings(loop=False, declare=(declared,))
    request = LabRequest(unit="mg", settings=settings, seed=0)
    return run_lab(read_position_table(path), request).calibration


@pytest.mark.parametrize(
    ("declared", "course"),
    [
        ("bias_step@record25", (np.arange(36) >= 24).astype(float)),
        ("bias_step@record8", (np.arange(36) >= 7).astype(float)),
        ("bias_drift", np.linspace(0.0, 1.0, 36)),
    ],
)
def test_a_later_recording_finds_the_sensor_as_it_was_left(
    declared: str, course: Array, tmp_path: Path
) -> None:
    found = calibrated(declared, course, tmp_path)
    true = 1000.0 * direction(np.array([10.0, -35.0]), np.array([75.0, 200.0]))
    raw = MG * (true + BIAS + CHANGE)
    channel = Channel(np.arange(2.0), raw, "m/s2", "acceleration", "imu0", 1.0)
    later = Recording({"imu0/acceleration": channel}, "later.csv", "csv", "")
    done = apply_to_recording(found, later)
    off = np.linalg.norm(done.channels["imu0/acceleration"].values / MG - true, axis=1)
    assert off.max() < 0.3
    (note,) = [n for n in done.notes if "left out" in n]
    assert "at the end of what was calibrated" in note
    linear = nearest_linear(found)
    assert np.linalg.norm((raw @ linear.M.T + linear.b) / MG - true, axis=1).max() < 0.3
