"""What a recording can do without never refuses it, and what only looks like damage is no loss."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imucalib import readers
from imucalib.errors import UnreadableInput, UsageError
from imucalib.recording.mapping import FieldMapping

ROWS = 300
HEADING = "time (s),acc_x (g),acc_y (g),acc_z (g)"


def acc() -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.round(np.array([0.03, -0.04, 0.99]) + rng.normal(scale=0.003, size=(ROWS, 3)), 5)


def table(
    path: Path, heading: str = HEADING, more: str = "", end: str = "\n", above: str = ""
) -> Path:
    lines = [f"{0.01 * k:.2f},{x:.5f},{y:.5f},{z:.5f}{more}" for k, (x, y, z) in enumerate(acc())]
    path.write_text(above + "\n".join([heading, *lines]) + end)
    return path


def count(found: readers.Recording) -> int:
    return found.channels["imu0/acceleration"].t.size


def test_a_table_does_without_a_thermometer_and_gyroscope_of_unknown_units(tmp_path: Path) -> None:
    more = ",gyr_x (furlong/s),gyr_y (furlong/s),gyr_z (furlong/s),temperature (Rankine)"
    path = table(tmp_path / "a.csv", HEADING + more, ",0.1,0.2,0.3,531.7")
    found = readers.read(path)
    assert set(found.channels) == {"imu0/acceleration"}
    assert any("temperature left out" in n and "'Rankine'" in n for n in found.notes)
    assert any("angular_rate left out" in n and "--gyro-unit" in n for n in found.notes)
    named = readers.read(path, FieldMapping(gyro_unit="deg/s", temperature_unit="degF"))
    assert len(named.channels) == 3
    with pytest.raises(UsageError, match="--temperature-unit"):
        readers.read(path, FieldMapping(temperature_unit="furlong"))
    alone = table(tmp_path / "b.csv", HEADING.replace("acc", "gyr").replace("(g)", "(furlong/s)"))
    with pytest.raises(UnreadableInput, match=r"furlong.*--gyro-unit"):
        readers.read(alone)


def test_a_last_line_that_lacks_only_its_end_is_a_row(tmp_path: Path) -> None:
    whole = readers.read(table(tmp_path / "a.csv"))
    ended = readers.read(table(tmp_path / "b.csv", end=""))
    assert ended.notes == whole.notes
    np.testing.assert_array_equal(
        ended.channels["imu0/acceleration"].values, whole.channels["imu0/acceleration"].values
    )
    cut = tmp_path / "c.csv"
    cut.write_bytes((tmp_path / "b.csv").read_bytes()[:-1])
    found = readers.read(cut)
    assert count(found) == ROWS - 1
    assert any("may be cut" in note for note in found.notes)
