"""Files that are HDF5 inside or nearly: netCDF4's tags, MATLAB 7.3, and MATLAB 5 beside them.

netCDF4 files are written with h5py and the attributes of CF Conventions 1.11 (4.4 time, 8.1 packed
data); MATLAB 5 files with scipy; a 7.3 file is HDF5 behind a text of 512 bytes, axes exchanged.
"""

from __future__ import annotations

import time
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from imucalib.errors import UnreadableInput
from imucalib.readers import blocks, read

N, RATE = 3000, 100.0
RNG = np.random.default_rng(0)
ACC = np.array([0.2, -0.1, 9.8]) + RNG.normal(scale=0.03, size=(N, 3))
GYRO = RNG.normal(scale=0.01, size=(N, 3))
T = np.arange(N) / RATE


@pytest.mark.parametrize(
    ("units", "factor"),
    [
        ("seconds since 2020-01-01 00:00:00", 1.0),
        ("milliseconds since 2020-01-01T00:00:00Z", 1000.0),
        ("microseconds since 2020-1-1 02:00:00 +02:00", 1e6),
    ],
)
def test_netcdfs_clock_units_packing_and_missing_values(
    units: str, factor: float, tmp_path: Path
) -> None:
    path = tmp_path / "a.nc"
    with h5py.File(path, "w") as file:
        file["time"] = (T + 5.0) * factor
        file["time"].attrs["units"] = units
        packed = np.rint((ACC - 1.0) / 0.001).astype("i2")
        packed[7] = -32768
        file["acceleration"] = packed
        tags = file["acceleration"].attrs
        tags["units"], tags["scale_factor"], tags["add_offset"] = "m s-2", 0.001, 1.0
        tags["_FillValue"] = np.array([-32768], "i2")
        file["angular_velocity"] = np.rad2deg(GYRO)
        file["angular_velocity"].attrs["units"] = "degree s-1"
        file["temperature"] = np.full(N, 293.15)
        file["temperature"].attrs["units"] = "K"
    found = read(path)
    acc, gyro = found.channels["imu0/acceleration"], found.channels["imu0/angular_rate"]
    np.testing.assert_allclose(acc.values, np.delete(ACC, 7, axis=0), atol=0.0006)
    np.testing.assert_allclose(gyro.values, GYRO, atol=1e-12)
    np.testing.assert_allclose(gyro.t, T, atol=1e-6)
    np.testing.assert_allclose(found.channels["imu0/temperature"].values, 20.0)
    assert found.start_ns == pytest.approx((1_577_836_800 + 5) * 10**9, abs=1000)


@pytest.mark.parametrize("nested", [False, True])
@pytest.mark.parametrize("packed", [False, True])
def test_matlab_up_to_version_7(nested: bool, packed: bool, tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    content = {"Accelerometer": ACC, "Gyroscope": GYRO, "Time": T[:, None], "name": "left wrist"}
    savemat(path, {"data": content} if nested else content, do_compression=packed)
    found = read(path)
    names = {n.split("/")[1]: c for n, c in found.channels.items()}
    np.testing.assert_array_equal(names["acceleration"].values, ACC)
    np.testing.assert_array_equal(names["angular_rate"].values, GYRO)
    np.testing.assert_allclose(names["acceleration"].t, T)
    assert found.format == "matlab"
    parts = [c for b in blocks(path, block_samples=500) for c in b.channels.values()]
    assert sum(c.t.size for c in parts if c.quantity == "acceleration") == N


def test_matlabs_rate_and_version_7_3(tmp_path: Path) -> None:
    """The newer is HDF5 behind a text of 512 bytes."""
    path = tmp_path / "a.mat"
    savemat(path, {"acc": ACC.T, "fs": 50.0})
    acc = read(path).channels["imu0/acceleration"]
    np.testing.assert_array_equal(acc.values, ACC)
    assert acc.rate == 50.0
    with h5py.File(path, "w", userblock_size=512) as file:
        file["acc"], file["time"] = ACC.T, T[None, :]
    data = bytearray(path.read_bytes())
    data[:128] = b"MATLAB 7.3 MAT-file, HDF5 schema 1.00 .".ljust(124) + b"\x00\x02IM"
    path.write_bytes(bytes(data))
    acc = read(path).channels["imu0/acceleration"]
    np.testing.assert_array_equal(acc.values, ACC)
    np.testing.assert_allclose(acc.t, T)


def test_every_cut_of_a_matlab_file_is_told(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    savemat(path, {"acc": ACC[:40], "time": T[:40, None]}, do_compression=True)
    whole = path.read_bytes()
    for size in range(0, len(whole) - 1, 13):
        path.write_bytes(whole[:size])
        with pytest.raises(UnreadableInput):
            read(path)


@pytest.mark.slow
def test_a_matlab_file_made_to_cost_ends_soon(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    savemat(path, {"acc": np.zeros((1 << 22, 3))}, do_compression=True)
    assert path.stat().st_size < 1 << 18
    start = time.process_time()
    with pytest.raises(UnreadableInput, match="claim"):
        read(path)
    assert time.process_time() - start < 5.0
    assert zlib.crc32(path.read_bytes())  # nothing wrote to it
