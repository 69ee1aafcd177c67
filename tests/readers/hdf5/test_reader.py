"""HDF5: layouts in use are found, damage is located, units are known or asked for."""

import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from imucalib import readers, writers
from imucalib.errors import UnreadableInput
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.segments import still_segments
from imucalib.units import DEG, STANDARD_GRAVITY
from worlds.places import SAMPLES

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
    assert set(found.channels) == {
        "Lumbar/acceleration", "Lumbar/angular_rate", "Wrist/acceleration", "Wrist/angular_rate"
    }  # fmt: skip
    channel = found.channels["Wrist/acceleration"]
    np.testing.assert_array_equal(channel.values, TRUTH)
    np.testing.assert_array_equal(channel.t, 7812 * np.arange(N) / 1e6)
    assert found.start_ns == 1_600_000_000_000_000_000


def test_counts_of_several_triads_with_a_scale(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    counts = np.round(np.stack([TRUTH, -TRUTH], axis=1) / 0.005).astype(np.int16)
    with h5py.File(path, "w") as f:
        f["time"] = np.arange(N) / 100
        f["accelerometer_counts"] = counts
        f["accelerometer_counts"].attrs["scale"] = 0.005
        f["accelerometer_counts"].attrs["unit"] = "m/s^2 per count"
        f["time"].attrs["unit"] = "s"
    found = readers.read(path)
    np.testing.assert_array_equal(found.channels["imu1/acceleration"].values, counts[:, 1] * 0.005)
    raw = readers.read(path, FieldMapping(acc_unit="counts")).channels["imu0/acceleration"]
    assert raw.unit == "counts"
    np.testing.assert_array_equal(raw.values, counts[:, 0])


def test_axes_apart_tables_and_transposed(tmp_path: Path) -> None:
    t = np.arange(N) / 50
    for kind in ("apart", "table", "transposed"):
        path = tmp_path / f"{kind}.h5"
        with h5py.File(path, "w") as f:
            if kind == "apart":
                for k, axis in enumerate("xyz"):
                    f[f"log/a{axis}"] = TRUTH[:, k] / STANDARD_GRAVITY
                f["log/t"] = t
            elif kind == "table":
                table = np.zeros(
                    N, dtype=[("time", "f8"), ("ax", "f8"), ("ay", "f8"), ("az", "f8")]
                )
                table["time"] = t
                for k, axis in enumerate("xyz"):
                    table[f"a{axis}"] = TRUTH[:, k] / STANDARD_GRAVITY
                f["readings"] = table
            else:
                f["acceleration"] = TRUTH.T / STANDARD_GRAVITY
                f["time"] = t
        found = readers.read(path)
        (channel,) = found.channels.values()
        np.testing.assert_allclose(channel.values, TRUTH, rtol=1e-13, err_msg=kind)
        np.testing.assert_array_equal(channel.t, t, err_msg=kind)
        assert any("-> unit g" in n for n in found.notes)


def own(path: Path, n: int = 40_000) -> Recording:
    rng = np.random.default_rng(1)
    values = np.array([0, 0, 9.8]) + rng.normal(scale=0.01, size=(n, 3))
    channel = Channel(np.arange(n) / 100, values, "m/s2", "acceleration", "imu0", 100.0)
    recording = Recording({"imu0/acceleration": channel}, "", "", "")
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
def test_the_real_array_board() -> None:
    found = readers.read(SAMPLES / "board.h5")
    assert len(found.channels) == 16
    with h5py.File(SAMPLES / "board.h5") as f:
        counts, scale = f["gyroscope_counts"][:, 3], f["gyroscope_counts"].attrs["scale"]
    np.testing.assert_allclose(
        found.channels["imu3/angular_rate"].values, counts * scale * DEG, rtol=1e-13
    )
    rests = still_segments(found)
    unit = rests.mean[:, 0] / np.linalg.norm(rests.mean[:, 0], axis=1)[:, None]
    turned = np.degrees(np.arccos(np.clip(np.sum(unit[1:] * unit[:-1], axis=1), -1, 1))) > 5
    assert 1 + turned.sum() == 20
    assert rests.n <= 22


def test_a_flipped_byte_of_ours_costs_ten_seconds(tmp_path: Path) -> None:
    path, n = tmp_path / "a.h5", 20_000
    values = np.array([0, 0, 9.8]) + np.random.default_rng(0).normal(scale=0.02, size=(n, 3))
    sensor = Channel(np.arange(n) / 100.0, values, "m/s2", "acceleration", "imu0", 100.0)
    writers.write(Recording({"imu0/acceleration": sensor}, "", "", ""), path)
    data = bytearray(path.read_bytes())
    data[data.find(values[9000].tobytes()) + 3] ^= 8
    path.write_bytes(data)
    found = readers.read(path).channels["imu0/acceleration"]
    assert n - 1024 <= found.t.size < n
    np.testing.assert_array_equal(found.values, values[np.rint(found.t * 100).astype(int)])


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
