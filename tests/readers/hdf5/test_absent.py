"""HDF5 rows that the file does not hold, and data that lies in other files."""

from __future__ import annotations

import re
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner

from imucalib import cli, readers
from imucalib.errors import ImucalError, UnreadableInput
from imucalib.recording.mapping import FieldMapping, from_dict
from imucalib.recording.recording import Recording

N, CHUNK = 2000, 100
TRUTH = np.array([0.1, -0.2, 9.75]) + np.random.default_rng(0).normal(scale=0.02, size=(N, 3))
STAMPS = 1_600_000_000_000_000_001 + 10_000_000 * np.arange(N)
ALLOWED = from_dict({"allow_external": True})


def chunked(path: Path, absent: slice, *, of: str = "acc") -> Path:
    with h5py.File(path, "w") as file:
        for name, data, tail in (("acc", TRUTH, (3,)), ("time", STAMPS, ())):
            options = {"chunks": (CHUNK, *tail), "fletcher32": True, "dtype": data.dtype}
            held = file.create_dataset(name, shape=data.shape, **options)
            gone = range(*absent.indices(N)) if of in (name, "both") else range(0)
            for a in range(0, N, CHUNK):
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
    np.testing.assert_array_equal(channel.values, TRUTH[rows])
    np.testing.assert_array_equal(ns, STAMPS[rows])
    return rows.size


@pytest.mark.parametrize("of", ["acc", "time", "both"])
@pytest.mark.parametrize("absent", [slice(300, 700), slice(0, 100), slice(1900, 2000)])
def test_chunks_that_were_never_written_are_missing(of: str, absent: slice, tmp_path: Path) -> None:
    path = chunked(tmp_path / "a.h5", absent, of=of)
    found = readers.read(path)
    assert only_truth(found) == N - (absent.stop - absent.start)
    assert any(f"rows {absent.start} to {absent.stop - 1} are not in" in n for n in found.notes)
    if absent.start == 300:
        assert found.gaps[0].stop - found.gaps[0].start == pytest.approx(4.01)
    with pytest.raises(UnreadableInput, match="not in the file"):
        readers.read(path, strict=True)
    parts = list(readers.blocks(path, block_samples=150))
    assert sum(c.t.size for p in parts for c in p.channels.values()) == N - 100 * (
        (absent.stop - absent.start) // 100
    )


def test_storage_that_was_never_filled_is_missing(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name in ("left", "right"):
            sensor = file.create_dataset(f"{name}/acc", shape=(N, 3), dtype="f8")
            sensor.attrs["units"] = "m/s2"
            file[name].attrs["rate"] = 100.0
            if name == "left":
                sensor[...] = TRUTH
    found = readers.read(tmp_path / "a.h5")
    assert list(found.channels) == ["left/acceleration"]
    assert any("/right/acc: rows 0 to 1999" in note for note in found.notes)


def virtual(path: Path, source: str) -> Path:
    layout = h5py.VirtualLayout(shape=(N, 3), dtype="f8")
    layout[:500] = h5py.VirtualSource(source, "x", shape=(500, 3))
    layout[500:] = h5py.VirtualSource(".", "own", shape=(N - 500, 3))
    with h5py.File(path, "w") as file:
        file["own"] = TRUTH[500:]
        file.create_virtual_dataset("acc", layout)
        file["acc"].attrs["units"] = "m/s2"
        file["time"] = STAMPS
        file["time"].attrs["units"] = "ns"
    return path


def test_a_virtual_dataset_without_its_source_is_missing(tmp_path: Path) -> None:
    path = virtual(tmp_path / "a.h5", "other.h5")
    with pytest.raises(UnreadableInput, match=r"other.h5.*--allow-external"):
        readers.read(path)
    assert only_truth(readers.read(path, ALLOWED)) == N - 500
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file.create_dataset("x", shape=(500, 3), chunks=(100, 3), dtype="f8")[:100] = TRUTH[:100]
    assert only_truth(readers.read(path, ALLOWED)) == N - 500
    with h5py.File(tmp_path / "other.h5", "a") as file:
        file["x"][...] = TRUTH[:500]
    assert only_truth(readers.read(path, ALLOWED)) == N


def test_external_storage_is_read_only_when_allowed(tmp_path: Path) -> None:
    secret, path, target = tmp_path / "secret.bin", tmp_path / "a.h5", tmp_path / "b.csv"
    secret.write_bytes(TRUTH.tobytes())
    with h5py.File(path, "w") as file:
        file.create_dataset(
            "acc", shape=(N, 3), dtype="f8", external=[(str(secret), 0, TRUTH.nbytes)]
        )
        file["acc"].attrs["units"], file["time"] = "m/s2", STAMPS
        file["time"].attrs["units"] = "ns"
    with pytest.raises(UnreadableInput, match=r"secret.bin.*--allow-external"):
        readers.read(path)
    result = CliRunner().invoke(cli.cli, ["convert", str(path), str(target)])
    assert result.exit_code != 0
    assert not target.exists()
    arguments = ["convert", str(path), str(target), "--allow-external"]
    assert CliRunner().invoke(cli.cli, arguments).exit_code == 0
    assert only_truth(readers.read(target)) == N
    secret.write_bytes(b"short")
    with pytest.raises(ImucalError):
        readers.read(path, ALLOWED)


@pytest.mark.slow
def test_a_damaged_index_never_gives_wrong_samples(tmp_path: Path) -> None:
    """Bits of the trees that say where the chunks are; those have checksums, the trees have not."""
    path = chunked(tmp_path / "a.h5", slice(0, 0))
    data = path.read_bytes()
    nodes = [m.start() for m in re.finditer(b"TREE\\x01", data)]  # version 1 trees of chunks
    assert len(nodes) >= 2
    inside = np.concatenate([np.arange(at, at + 1200) for at in nodes])
    rng = np.random.default_rng(1)
    where = inside[np.frombuffer(data, np.uint8)[inside] > 0]
    told = 0
    for at in rng.choice(where, 250, replace=False).tolist():
        damaged = bytearray(data)
        damaged[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        try:
            found = readers.read(path, FieldMapping())
        except ImucalError:
            told += 1
            continue
        channel = next(iter(found.channels.values()))
        zero = (channel.values == 0).all(axis=1)
        assert not zero.any(), at
        told += channel.t.size < N
    assert told > 20
