"""At the recording's border: rates that no sensor has, samples of one time, rows by a value."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from imucalib import readers
from imucalib.errors import UnreadableInput
from imucalib.recording.mapping import FieldMapping, from_dict
from worlds.mcap_logs import Reading, cdr, packed, write_log

ROWS = 400
Put = Callable[[Path, np.ndarray], Path]


def acc() -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.array([0.3, -0.4, 9.7]) + rng.normal(scale=0.02, size=(ROWS, 3))


def _csv(folder: Path, t: np.ndarray) -> Path:
    path = folder / "a.csv"
    lines = [",".join(map(repr, row)) for row in np.column_stack([t, acc()]).tolist()]
    path.write_text("time (s),acc_x (m/s2),acc_y (m/s2),acc_z (m/s2)\n" + "\n".join(lines) + "\n")
    return path


def _hdf5(folder: Path, t: np.ndarray) -> Path:
    path = folder / "a.h5"
    with h5py.File(path, "w") as file:
        file["acceleration"] = acc()
        file["acceleration"].attrs["units"] = "m/s2"
        file["time"] = t
        file["time"].attrs["units"] = "s"
    return path


def _mcap(folder: Path, t: np.ndarray) -> Path:
    path = folder / "a.mcap"
    ns = np.rint(t * 1e9).astype(np.int64) + 1_700_000_000 * 10**9
    rows = [
        Reading(int(n), tuple(a), (0.0, 0.0, 0.0), "imu") for n, a in zip(ns, acc(), strict=True)
    ]
    write_log(path, {"/imu": packed(rows, cdr)})
    return path


FORMATS = pytest.mark.parametrize("put", [_csv, _hdf5, _mcap], ids=lambda f: f.__name__[1:])


@FORMATS
@pytest.mark.parametrize("step", [2e-6, 30.0])
def test_a_rate_that_no_sensor_has_is_refused(put: Put, step: float, tmp_path: Path) -> None:
    path = put(tmp_path, np.arange(ROWS) * step)
    with pytest.raises(UnreadableInput, match=r"samples a second.*--time-unit.*--rate"):
        readers.read(path)
    with pytest.raises(UnreadableInput, match=r"samples a second"):
        list(readers.blocks(path, block_samples=50))
    assert readers.read(path, FieldMapping(rate=50.0)).channels


@pytest.mark.parametrize(
    ("modulus", "unit"),
    [(2**32, "ms"), (2**32, "us"), (2**16, "ms"), (2**24, "us"), (86_400_000, "ms"), (3600, "s")],
)
@pytest.mark.parametrize("put", [_csv, _hdf5], ids=["csv", "hdf5"])
def test_a_counter_that_wraps_is_unrolled(
    put: Put, modulus: int, unit: str, tmp_path: Path
) -> None:
    size = {"s": 1.0, "ms": 1e-3, "us": 1e-6}[unit]
    whole = modulus * size
    t = (whole - 1.5 + 0.02 * np.arange(ROWS)) % whole
    path = put(tmp_path, np.round(t, 6))
    found = readers.read(path)
    channel = found.channels["imu0/acceleration"]
    np.testing.assert_allclose(channel.t - channel.t[0], 0.02 * np.arange(ROWS), atol=1e-5)
    assert not found.gaps
    assert any("begin again" in note for note in found.notes)
    parts = list(readers.blocks(path, block_samples=64))
    t = np.concatenate([p.channels["imu0/acceleration"].t for p in parts])
    np.testing.assert_allclose(t - t[0], 0.02 * np.arange(ROWS), atol=1e-5)


def _two_tools(folder: Path, *, time: bool = True) -> Path:
    lines = ["serial,id," + "time (s)," * time + "acc_x (m/s2),acc_y (m/s2),acc_z (m/s2)"]
    for k, a in enumerate(acc().tolist()):
        name, number = ("A12", "1.0") if k < ROWS // 2 else ("B07", "2.0")
        stamp = [f"{0.01 * k:.2f}"] * time
        lines.append(",".join([name, number, *stamp, *map(repr, a)]))
    path = folder / "two.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("where", ["serial=B07", "id=2", "1=B07"])
@pytest.mark.parametrize("time", [True, False])
def test_rows_are_selected_by_a_value(where: str, time: bool, tmp_path: Path) -> None:
    path = _two_tools(tmp_path, time=time)
    mapping = FieldMapping(where=(where,), rate=None if time else 100.0)
    found = readers.read(path, mapping)
    np.testing.assert_array_equal(found.channels["imu0/acceleration"].values, acc()[ROWS // 2 :])
    assert not any("serial" in note for note in found.notes)
    again = readers.read(path, from_dict(found.mapping))
    np.testing.assert_array_equal(again.channels["imu0/acceleration"].values, acc()[ROWS // 2 :])
    parts = list(readers.blocks(path, mapping, block_samples=30))
    values = np.concatenate([p.channels["imu0/acceleration"].values for p in parts])
    np.testing.assert_array_equal(values, acc()[ROWS // 2 :])
