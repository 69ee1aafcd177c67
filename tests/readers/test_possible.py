"""What stands for no value, or no sensor reads, is left out and counted, in every format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from imucalib import readers
from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.recording.mapping import FieldMapping
from worlds.one_table import FORMATS, N, Table

ROWS = [7, 50, 51, 300]
NAMES = ("acc_x", "acc_y", "acc_z")


def force() -> Array:
    rng = np.random.default_rng(0)
    turned = np.where(np.arange(N)[:, None] < N // 2, [[-3.0, 1.0, 9.2]], [[5.0, -8.0, -2.4]])
    return np.round(turned + rng.normal(scale=0.02, size=(N, 3)), 5)


@pytest.mark.parametrize("write", FORMATS)
@pytest.mark.parametrize("code", [1e20, -9999.0, 99999.0, -32768.0, -999.0, 2e5])
@pytest.mark.parametrize("axes", [[1], [0, 1, 2]])
def test_a_value_for_none_is_no_acceleration(
    axes: list[int], code: float, write: Callable[[Path, Table], Path], tmp_path: Path
) -> None:
    acc = force()
    for axis in axes:
        acc[ROWS, axis] = code
    found = readers.read(write(tmp_path / "log", dict(zip(NAMES, acc.T, strict=True))))
    values = found.channels["imu0/acceleration"].values
    np.testing.assert_array_equal(values, np.delete(acc, ROWS, axis=0))
    (count,) = found.counts
    assert (count.held, count.read, sum(count.left.values())) == (N, N - len(ROWS), len(ROWS))
    assert any(f"{len(ROWS)} samples" in note for note in found.notes)


@pytest.mark.parametrize("write", FORMATS)
def test_a_large_reading_among_large_ones_is_one(
    write: Callable[[Path, Table], Path], tmp_path: Path
) -> None:
    acc = np.rint(force() * 1500.0)  # counts that reach 14,000
    acc[ROWS, 1] = -32768.0
    path = write(tmp_path / "log", dict(zip(NAMES, acc.T, strict=True)))
    found = readers.read(path, FieldMapping(acc_unit="counts", lsb_per_g=(1500 * 9.81,)))
    assert found.channels["imu0/acceleration"].t.size == N


@pytest.mark.parametrize("given", ["valid_range", "valid_min and valid_max"])
def test_what_the_file_calls_invalid_is_left_out(given: str, tmp_path: Path) -> None:
    acc = force()
    acc[ROWS, 2] = 500.0
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["time"], file["acceleration"] = np.arange(N) / 100, acc
        attributes = file["acceleration"].attrs
        if given == "valid_range":
            attributes["valid_range"] = [-160.0, 160.0]
        else:
            attributes["valid_min"], attributes["valid_max"] = -160.0, 160.0
    found = readers.read(tmp_path / "log.h5")
    assert found.channels["imu0/acceleration"].t.size == N - len(ROWS)
    assert any(f"{len(ROWS)} rows" in note for note in found.notes)


@pytest.mark.parametrize("write", FORMATS)
def test_a_sign_that_was_lost_is_given_back(
    write: Callable[[Path, Table], Path], tmp_path: Path
) -> None:
    acc = np.rint(force() / 9.81 * 2048.0)
    table = dict(zip(NAMES, (acc % 65536).T, strict=True))
    path = write(tmp_path / "log", table)
    found = readers.read(path, FieldMapping(acc_unit="counts", lsb_per_g=(2048.0,)))
    values = found.channels["imu0/acceleration"].values
    np.testing.assert_allclose(values, acc / 2048.0 * 9.80665, rtol=1e-12)
    assert any("without their sign" in note for note in found.notes)


def test_a_scale_that_gravity_refutes_is_refused(tmp_path: Path) -> None:
    table = dict(zip(NAMES, np.rint(force() / 9.81 * 2048.0).T, strict=True))
    path = FORMATS[0](tmp_path / "log", table)
    with pytest.raises(UnreadableInput, match=r"7.9\d? g when the unit is counts, as --lsb"):
        readers.read(path, FieldMapping(acc_unit="counts", lsb_per_g=(256.0,)))


def test_rows_of_devices_that_take_turns_are_refused(tmp_path: Path) -> None:
    rows = [f"{k % 2},{k // 2 / 100},{x},{y},{z}" for k, (x, y, z) in enumerate(force().tolist())]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["id,time,acc_x,acc_y,acc_z", *rows]) + "\n")
    with pytest.raises(UnreadableInput, match=r"take turns.*--where id=0"):
        readers.read(path)
    one = readers.read(path, FieldMapping(where=("id=1",)))
    assert one.channels["imu0/acceleration"].t.size == N // 2
