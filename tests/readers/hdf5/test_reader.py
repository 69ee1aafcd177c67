"""HDF5 and its relatives: layouts, clocks, damage, and what is not in the file."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from imucalib import readers, writers
from imucalib.errors import ImucalError, UnreadableInput
from imucalib.readers import blocks, read
from imucalib.recording.mapping import FieldMapping, from_dict
from imucalib.recording.recording import Recording
from imucalib.units import STANDARD_GRAVITY
from worlds.command import run
from worlds.recordings import recording_of

N = 4000
TRUTH = np.array([0.1, -0.2, 9.75]) + np.random.default_rng(0).normal(scale=0.02, size=(N, 3))


def test_apdm_opal(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as f:
        for number, label in (("1234", "Lumbar"), ("5678", "Wrist")):
            sensor = f.create_group(f"Sensors/{number}")
            sensor["Accelerometer"] = TRUTH
            sensor["Gyroscope"] = TRUTH * 0.01
            sensor["Time"] = 1_600_000_000_000_000 + 7812 * np.arange(N)
            configuration = sensor.create_group("Configuration")
            configuration.attrs["Label 0"] = np.bytes_(label.ljust(16, "\0"))
    found = readers.read(path)
    quantities = ("acceleration", "angular_rate")
    assert set(found.channels) == {f"{n}/{q}" for n in ("Lumbar", "Wrist") for q in quantities}
    channel = found.channels["Wrist/acceleration"]
    np.testing.assert_array_equal(channel.values, TRUTH)
    np.testing.assert_array_equal(channel.t, 7812 * np.arange(N) / 1e6)
    assert found.start_ns == 1_600_000_000_000_000_000


def test_counts_of_several_triads_with_a_scale(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    counts = np.round(np.stack([TRUTH, -TRUTH], axis=1) / 0.005).astype(np.int16)
    with h5py.File(path, "w") as f:
        f["time"], f["accelerometer_counts"] = np.arange(N) / 100, counts
        f["accelerometer_counts"].attrs["scale"] = 0.005
        f["accelerometer_counts"].attrs["unit"] = "m/s^2 per count"
        f["time"].attrs["unit"] = "s"
    found = readers.read(path)
    np.testing.assert_array_equal(found.channels["imu1/acceleration"].values, counts[:, 1] * 0.005)
    raw = readers.read(path, FieldMapping(acc_unit="counts")).channels["imu0/acceleration"]
    assert raw.unit == "counts"
    np.testing.assert_array_equal(raw.values, counts[:, 0])


def _apart(file: h5py.File, t: np.ndarray, g: np.ndarray) -> None:
    for k, axis in enumerate("xyz"):
        file[f"log/a{axis}"] = g[:, k]
    file["log/t"] = t


def _table(file: h5py.File, t: np.ndarray, g: np.ndarray) -> None:
    table = np.zeros(N, dtype=[(name, "f8") for name in ("time", "ax", "ay", "az")])
    for name, column in zip(table.dtype.names, (t, *g.T), strict=True):
        table[name] = column
    file["readings"] = table


def _transposed(file: h5py.File, t: np.ndarray, g: np.ndarray) -> None:
    file["acceleration"], file["time"] = g.T, t


@pytest.mark.parametrize("put", [_apart, _table, _transposed])
def test_axes_apart_tables_and_transposed(
    put: Callable[[h5py.File, np.ndarray, np.ndarray], None], tmp_path: Path
) -> None:
    t = np.arange(N) / 50
    with h5py.File(tmp_path / "a.h5", "w") as file:
        put(file, t, TRUTH / STANDARD_GRAVITY)
    found = readers.read(tmp_path / "a.h5")
    (channel,) = found.channels.values()
    np.testing.assert_allclose(channel.values, TRUTH, rtol=1e-13)
    np.testing.assert_array_equal(channel.t, t)
    assert any("-> unit g" in n for n in found.notes)


def own(path: Path, n: int = 40_000) -> Recording:
    rng = np.random.default_rng(1)
    values = np.array([0, 0, 9.8]) + rng.normal(scale=0.01, size=(n, 3))
    recording = recording_of(np.arange(n) / 100, values, hz=100.0)
    writers.write(recording, path)
    return recording


def test_a_bad_checksum_costs_one_chunk_and_is_located(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    want = own(path).channels["imu0/acceleration"]
    with h5py.File(path) as f:
        node = f["imu0/acceleration/values"]
        info = node.id.get_chunk_info(1)
        rows = node.chunks[0]
        at = info.byte_offset + info.size // 2
    data = bytearray(path.read_bytes())
    data[at] ^= 16
    path.write_bytes(bytes(data))
    found = readers.read(path)
    got = found.channels["imu0/acceleration"]
    keep = np.r_[0:rows, 2 * rows : want.t.size]
    np.testing.assert_array_equal(got.values, want.values[keep])
    np.testing.assert_array_equal(got.t, want.t[keep])
    assert any(f"rows {rows} to {2 * rows - 1}" in n and "checksum" in n for n in found.notes)
    (gap,) = found.gaps
    assert (gap.start, gap.stop) == (want.t[rows - 1], want.t[2 * rows])
    with pytest.raises(UnreadableInput, match="values"):
        readers.read(path, strict=True)


def test_a_writer_that_was_killed(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w", libver="latest") as f:
        acc = f.create_dataset("acc", data=TRUTH, chunks=(1000, 3), maxshape=(None, 3))
        acc.attrs["units"] = "m/s2"
        f.attrs["sampling_rate"] = 100.0
        f.swmr_mode = True
        acc.flush()
        copy = tmp_path / "b.h5"
        copy.write_bytes(path.read_bytes())
    found = readers.read(copy)
    np.testing.assert_array_equal(found.channels["imu0/acceleration"].values, TRUTH)
    assert any("did not close" in n for n in found.notes)
    with pytest.raises(UnreadableInput, match="did not close"):
        readers.read(copy, strict=True)


@pytest.mark.slow
def test_a_heap_whose_walk_would_not_end_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["acceleration"] = TRUTH[:50]
        file["acceleration"].attrs["units"] = "m/s2"  # of no fixed length: in a heap
        file["acceleration"].attrs["sampling_rate"] = 100.0
    data = path.read_bytes()
    at = data.index(b"GCOL")
    for first, size in ((at + 16, 16), (at + 40, 200)):
        code = f"import imucalib.readers as r; r.read({str(path)!r})"
        path.write_bytes(data[:first] + bytes(size) + data[first + size :])
        run = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False
        )
        assert f"byte {at}: a heap of texts is damaged" in run.stderr


RELATIVES_N, RATE = 3000, 100.0
RNG = np.random.default_rng(0)
ACC = np.array([0.2, -0.1, 9.8]) + RNG.normal(scale=0.03, size=(RELATIVES_N, 3))
GYRO = RNG.normal(scale=0.01, size=(RELATIVES_N, 3))
T = np.arange(RELATIVES_N) / RATE


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
        file["temperature"] = np.full(RELATIVES_N, 293.15)
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
    assert sum(c.t.size for c in parts if c.quantity == "acceleration") == RELATIVES_N


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


ABSENT_N, CHUNK = 2000, 100
ABSENT_TRUTH = np.array([0.1, -0.2, 9.75]) + np.random.default_rng(0).normal(
    scale=0.02, size=(ABSENT_N, 3)
)
STAMPS = 1_600_000_000_000_000_001 + 10_000_000 * np.arange(ABSENT_N)
ALLOWED = from_dict({"allow_external": True})


def chunked(path: Path, absent: slice, *, of: str = "acc") -> Path:
    with h5py.File(path, "w") as file:
        for name, data, tail in (("acc", ABSENT_TRUTH, (3,)), ("time", STAMPS, ())):
            options = {"chunks": (CHUNK, *tail), "fletcher32": True, "dtype": data.dtype}
            held = file.create_dataset(name, shape=data.shape, **options)
            gone = range(*absent.indices(ABSENT_N)) if of in (name, "both") else range(0)
            for a in range(0, ABSENT_N, CHUNK):
                if a not in gone:
                    held[a : a + CHUNK] = data[a : a + CHUNK]
        file["acc"].attrs["units"], file["time"].attrs["units"] = "m/s2", "ns"
    return path


def only_truth(found: Recording) -> int:
    """How many samples were read; every one is what was written at its time."""
    assert found.start_ns is not None
    (channel,) = found.channels.values()
    ns = np.rint(channel.t * 1e9).astype(np.int64) + found.start_ns
    rows = np.rint((ns - STAMPS[0]) / 10_000_000).astype(int)
    np.testing.assert_array_equal(channel.values, ABSENT_TRUTH[rows])
    np.testing.assert_array_equal(ns, STAMPS[rows])
    return rows.size


@pytest.mark.parametrize("of", ["acc", "time", "both"])
@pytest.mark.parametrize("absent", [slice(300, 700), slice(0, 100), slice(1900, 2000)])
def test_chunks_that_were_never_written_are_missing(of: str, absent: slice, tmp_path: Path) -> None:
    path = chunked(tmp_path / "a.h5", absent, of=of)
    found = readers.read(path)
    assert only_truth(found) == ABSENT_N - (absent.stop - absent.start)
    assert any(f"rows {absent.start} to {absent.stop - 1} are not in" in n for n in found.notes)
    if absent.start == 300:
        assert found.gaps[0].stop - found.gaps[0].start == pytest.approx(4.01)
    with pytest.raises(UnreadableInput, match="not in the file"):
        readers.read(path, strict=True)
    parts = list(readers.blocks(path, block_samples=150))
    assert sum(c.t.size for p in parts for c in p.channels.values()) == ABSENT_N - 100 * (
        (absent.stop - absent.start) // 100
    )


def virtual(path: Path, source: str) -> Path:
    layout = h5py.VirtualLayout(shape=(ABSENT_N, 3), dtype="f8")
    layout[:500] = h5py.VirtualSource(source, "x", shape=(500, 3))
    layout[500:] = h5py.VirtualSource(".", "own", shape=(ABSENT_N - 500, 3))
    with h5py.File(path, "w") as file:
        file["own"] = ABSENT_TRUTH[500:]
        file.create_virtual_dataset("acc", layout)
        file["acc"].attrs["units"] = "m/s2"
        file["time"] = STAMPS
        file["time"].attrs["units"] = "ns"
    return path


def test_a_virtual_dataset_needs_its_sources_whole(tmp_path: Path) -> None:
    path = virtual(tmp_path / "a.h5", "other.h5")
    with pytest.raises(UnreadableInput, match=r"other.h5.*--allow-external"):
        readers.read(path)
    with pytest.raises(UnreadableInput, match=r"needs x of other.h5, which is not whole"):
        readers.read(path, ALLOWED)
    with h5py.File(tmp_path / "other.h5", "w") as file:
        part = file.create_dataset("x", shape=(500, 3), chunks=(100, 3), dtype="f8")
        part[:100] = ABSENT_TRUTH[:100]
    with pytest.raises(UnreadableInput, match=r"which is not whole"):
        readers.read(path, ALLOWED)
    with h5py.File(tmp_path / "other.h5", "a") as file:
        file["x"][...] = ABSENT_TRUTH[:500]
    assert only_truth(readers.read(path, ALLOWED)) == ABSENT_N


def test_a_virtual_dataset_that_claims_more_or_itself_is_refused(tmp_path: Path) -> None:
    layout = h5py.VirtualLayout(shape=(ABSENT_N, 3), dtype="f8")
    layout[:500] = h5py.VirtualSource(".", "own", shape=(500, 3))
    again = h5py.VirtualLayout(shape=(500, 3), dtype="f8")
    again[:] = h5py.VirtualSource(".", "gyro", shape=(500, 3))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["own"] = ABSENT_TRUTH[:500]
        file.attrs["sampling_rate"] = 100.0
        file.create_virtual_dataset("acc", layout)
    with pytest.raises(UnreadableInput, match=r"claims 6000 values, and its sources hold 1500"):
        readers.read(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "a") as file:
        del file["acc"]
        file.create_virtual_dataset("gyro", again)
    with pytest.raises(UnreadableInput, match=r"is a part of itself"):
        readers.read(tmp_path / "a.h5", FieldMapping(gyro_unit="rad/s"))


def test_external_storage_is_read_only_when_allowed(tmp_path: Path) -> None:
    secret, path, target = tmp_path / "secret.bin", tmp_path / "a.h5", tmp_path / "b.csv"
    secret.write_bytes(ABSENT_TRUTH.tobytes())
    with h5py.File(path, "w") as file:
        file.create_dataset(
            "acc", shape=(ABSENT_N, 3), dtype="f8", external=[(str(secret), 0, ABSENT_TRUTH.nbytes)]
        )
        file["acc"].attrs["units"], file["time"] = "m/s2", STAMPS
        file["time"].attrs["units"] = "ns"
    with pytest.raises(UnreadableInput, match=r"secret.bin.*--allow-external"):
        readers.read(path)
    assert run("convert", path, target).exception is not None
    assert not target.exists()
    assert run("convert", path, target, "--allow-external").exception is None
    assert only_truth(readers.read(target)) == ABSENT_N
    secret.write_bytes(b"short")
    with pytest.raises(ImucalError):
        readers.read(path, ALLOWED)
