"""ActiGraph's .gt3x: both packings, gaps, damage, and the maker's own CSV of the same recording."""

from __future__ import annotations

import gzip
import struct
import time
import zipfile
from contextlib import suppress
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from imucalib.errors import ImucalError, UnreadableInput
from imucalib.readers import blocks, read
from imucalib.units import STANDARD_GRAVITY
from worlds.places import DATA, needs_data

FOLDER = DATA / "actigraph"
START = 1_600_000_000
INFO = "Serial Number: X1\nSample Rate: 30\nAcceleration Scale: 256.0\nTimeZone: 02:00:00\n"


def record(kind: int, stamp: int, payload: bytes) -> bytes:
    body = struct.pack("<BBIH", 0x1E, kind, stamp, len(payload)) + payload
    return body + bytes([reduce(xor, body) ^ 0xFF])


def packed(counts: np.ndarray) -> bytes:
    """12 bits a number, axes y x z."""
    bits = "".join(f"{int(v) & 0xFFF:012b}" for v in counts[:, [1, 0, 2]].ravel())
    return int(bits, 2).to_bytes(len(bits) // 8, "big")


def made(seconds: list[int], *, kind: int) -> tuple[bytes, np.ndarray]:
    rng = np.random.default_rng(kind)
    counts = rng.integers(-40, 40, size=(len(seconds), 30, 3)) + np.array([0, 0, 256])
    pack = packed if kind == 0 else (lambda c: c.astype("<i2").tobytes())
    rows = [record(kind, START + s, pack(c)) for s, c in zip(seconds, counts, strict=True)]
    rows.insert(1, record(3, START, b"\x08"))
    return b"".join(rows), counts.reshape(-1, 3)


def archive(path: Path, log: bytes, info: str = INFO) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("info.txt", info)
        file.writestr("log.bin", log)
    return path


@pytest.mark.parametrize("kind", [0, 26])
def test_both_packings_gaps_and_zone(tmp_path: Path, kind: int) -> None:
    log, counts = made([0, 1, 2, 7, 8], kind=kind)
    path = archive(tmp_path / "a.gt3x", log)
    recording = read(path)
    channel = recording.channels["imu0/acceleration"]
    np.testing.assert_allclose(channel.values, counts / 256.0 * STANDARD_GRAVITY, rtol=1e-12)
    np.testing.assert_allclose(channel.t[[0, 29, 30, 90]], [0.0, 29 / 30, 1.0, 7.0])
    assert [(g.start, g.stop) for g in recording.gaps] == [(3.0, 7.0)]
    assert recording.start_ns == (START - 7200) * 1_000_000_000
    parts = list(blocks(path, block_samples=40))
    assert len(parts) == 3
    joined = np.concatenate([p.channels["imu0/acceleration"].values for p in parts])
    np.testing.assert_array_equal(joined, channel.values)
    assert sum(len(p.gaps) for p in parts) == 1


def test_a_damaged_record_costs_its_second(tmp_path: Path) -> None:
    log, counts = made([0, 1, 2, 3], kind=26)
    hurt = bytearray(log)
    hurt[len(log) // 2] ^= 0x10
    path = archive(tmp_path / "a.gt3x", bytes(hurt))
    recording = read(path)
    assert len(recording.channels["imu0/acceleration"].t) == len(counts) - 30
    assert any("damaged bytes" in note for note in recording.notes)
    assert len(recording.gaps) == 1
    with pytest.raises(UnreadableInput, match=r"byte \d+ of log\.bin"):
        read(path, strict=True)


@pytest.mark.parametrize(
    ("info", "words"),
    [
        ("Sample Rate: 30\n", ""),
        ("Serial: 1\n", "sample rate"),
        ("Sample Rate: 0\n", "sample rate"),
    ],
)
def test_info_that_is_not_whole(tmp_path: Path, info: str, words: str) -> None:
    log, _ = made([0, 1], kind=26)
    path = archive(tmp_path / "a.gt3x", log, info)
    if words:
        with pytest.raises(UnreadableInput, match=words):
            read(path)
    else:
        notes = read(path).notes
        assert any("time zone is not in the file" in note for note in notes)


def _read_or_none(path: Path) -> np.ndarray | None:
    """What is read of a cut archive, told as such; None where nothing is."""
    try:
        found = read(path)
    except ImucalError:
        return None
    assert any("breaks off" in note or "lost its directory" in note for note in found.notes)
    with pytest.raises(UnreadableInput):
        read(path, strict=True)
    return found.channels["imu0/acceleration"].values


@pytest.mark.parametrize("streamed", [False, True])
def test_an_archive_that_was_cut_gives_what_comes_before(tmp_path: Path, streamed: bool) -> None:
    log, counts = made(list(range(20)), kind=26)
    path = tmp_path / "a.gt3x"
    with path.open("wb") as raw, zipfile.ZipFile(raw, "w", zipfile.ZIP_DEFLATED) as file:
        if streamed:  # sizes come after the members, as from a pipe
            raw.seekable = lambda: False  # type: ignore[method-assign]
        file.writestr("info.txt", INFO)
        file.writestr("log.bin", log)
    whole, true, sizes = path.read_bytes(), counts / 256.0 * STANDARD_GRAVITY, set[int]()
    for size in range(0, len(whole) - 1, 37):
        cut = tmp_path / "cut.gt3x"
        cut.write_bytes(whole[:size])
        values = _read_or_none(cut)
        if values is not None:
            np.testing.assert_allclose(values, true[: len(values)], rtol=1e-12)
            sizes.add(len(values))
    assert max(sizes) == len(true)
    assert len(sizes) > 5


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(at=st.floats(0.0, 1.0, exclude_max=True), bit=st.integers(0, 7))
def test_a_flipped_bit_is_no_traceback(tmp_path: Path, at: float, bit: int) -> None:
    log, _ = made([0, 1, 2], kind=26)
    data = bytearray(archive(tmp_path / "a.gt3x", log).read_bytes())
    data[int(at * len(data))] ^= 1 << bit
    path = tmp_path / "b.gt3x"
    path.write_bytes(bytes(data))
    with suppress(ImucalError):
        read(path)


@needs_data
def test_the_makers_own_csv_of_the_same_recording() -> None:
    name = "read_gt3x_TAS1H30182785_2019-09-17"
    recording = read(FOLDER / f"{name}.gt3x")
    channel = recording.channels["imu0/acceleration"]
    with gzip.open(FOLDER / f"{name}.csv.gz") as file:
        rows = np.loadtxt(file, delimiter=",", skiprows=11)
    assert recording.start_ns is not None
    first = round((recording.start_ns / 1e9 - 4 * 3600 - 1_568_745_600) * 100)
    at = np.rint(channel.t * 100).astype(int) + first
    assert at.size == 33_000
    assert np.abs(rows[at] - channel.values / STANDARD_GRAVITY).max() <= 0.00051  # 3 decimals


@pytest.mark.parametrize(
    ("log", "info", "words"),
    [
        (b"\x1e" * (15 << 20), INFO, "no records"),
        (b"\0" * (64 << 20), INFO, "claims 67108864 bytes"),
        (b"", INFO + "x" * (8 << 20), "longer than"),
    ],
)
def test_an_archive_made_to_cost_ends_soon(
    log: bytes, info: str, words: str, tmp_path: Path
) -> None:
    path = archive(tmp_path / "a.gt3x", log, info)
    assert path.stat().st_size < 100_000
    start = time.process_time()
    with pytest.raises(UnreadableInput, match=words):
        read(path)
    assert time.process_time() - start < 10.0


def test_records_whose_stamp_is_not_later_are_told(tmp_path: Path) -> None:
    log, counts = made([0, 1, 2, 1, 1, 3], kind=26)
    path = archive(tmp_path / "a.gt3x", log)
    recording = read(path)
    channel = recording.channels["imu0/acceleration"]
    kept = np.delete(counts.reshape(6, 30, 3), [3, 4], axis=0).reshape(-1, 3)
    np.testing.assert_allclose(channel.values, kept / 256.0 * STANDARD_GRAVITY, rtol=1e-12)
    told = [note for note in recording.notes if "not later" in note]
    assert len(told) == 1
    assert told[0].startswith("2 records")
    with pytest.raises(UnreadableInput, match=r"byte \d+ of log\.bin: .*not later"):
        read(path, strict=True)


def test_an_archive_that_contradicts_its_checksum_is_told(tmp_path: Path) -> None:
    log, _ = made(list(range(900)), kind=26)
    changed = bytearray(log)
    for at in (600, 602):  # twice the same bit: the record's own sum does not see it
        changed[at] ^= 4
    path = tmp_path / "a.gt3x"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("info.txt", INFO)
        file.writestr("log.bin", log)
    path.write_bytes(path.read_bytes().replace(log, bytes(changed)))
    assert any("log.bin breaks off" in note for note in read(path).notes)
    with pytest.raises(UnreadableInput, match="breaks off"):
        read(path, strict=True)
