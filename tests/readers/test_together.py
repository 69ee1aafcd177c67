"""Files of one phone, an accelerometer's and a gyroscope's, as one recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imucalib import readers
from imucalib.errors import UsageError
from imucalib.recording.mapping import FieldMapping

START = 1_700_000_000.0
UNITS = FieldMapping(gyro_unit="rad/s")


def put(path: Path, values: np.ndarray, t: np.ndarray, heading: str = "time (s),x,y,z") -> Path:
    lines = [f"{s:.4f},{x!r},{y!r},{z!r}" for s, (x, y, z) in zip(t, values.tolist(), strict=True)]
    path.write_text(heading + "\n" + "\n".join(lines) + "\n")
    return path


def phone(
    folder: Path, start: float, later: float = 0.3
) -> tuple[list[Path], np.ndarray, np.ndarray]:
    """Their files, the forces at 100 Hz and the rates at 80 Hz that begin later."""
    rng = np.random.default_rng(2)
    acc = np.array([0.2, -0.1, 9.75]) + rng.normal(scale=0.02, size=(900, 3))
    gyro = rng.normal(scale=0.2, size=(700, 3))
    one = put(folder / "Accelerometer.csv", acc, start + np.arange(900) / 100.0)
    two = put(folder / "Gyroscope.csv", gyro, start + later + np.arange(700) / 80.0)
    return [one, two], acc, gyro


@pytest.mark.parametrize("start", [START, 5000.0])
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("later", [0.3, -0.3])
def test_both_files_keep_their_moments(
    start: float, turned: bool, later: float, tmp_path: Path
) -> None:
    paths, acc, gyro = phone(tmp_path, start, later)
    found = readers.read_together(paths[::-1] if turned else paths, UNITS)
    force, turn = (found.channels[f"imu0/{q}"] for q in ("acceleration", "angular_rate"))
    np.testing.assert_array_equal(force.values, acc)
    np.testing.assert_array_equal(turn.values, gyro)
    assert turn.t[0] - force.t[0] == pytest.approx(later, abs=1e-6)
    if start == START:
        assert found.start_ns == pytest.approx((start + min(0.0, later)) * 1e9, abs=1e3)
    assert any("by the name of the file" in note for note in found.notes)


def test_what_does_not_belong_together_is_refused(tmp_path: Path) -> None:
    paths, acc, _ = phone(tmp_path, START)
    again = put(tmp_path / "again.csv", acc, START + np.arange(900) / 100.0)
    with pytest.raises(UsageError, match=r"acceleration is in Accelerometer.csv and in again.csv"):
        readers.read_together([paths[0], again])
    (tmp_path / "late").mkdir()
    late, _, _ = phone(tmp_path / "late", START + 3600.0)
    with pytest.raises(UsageError, match="clocks do not overlap"):
        readers.read_together([paths[0], late[1]])
    (tmp_path / "bare").mkdir()
    bare, _, _ = phone(tmp_path / "bare", 10.0)
    with pytest.raises(UsageError, match="has no date"):
        readers.read_together([paths[0], bare[1]])
