"""ActiGraph's archives, new and old: packings, gaps, damage, cost."""

from __future__ import annotations

import gzip
import io
import struct
import time
import zipfile
from contextlib import suppress
from datetime import UTC, datetime
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from imucalib.errors import ImucalError, UnreadableInput
from imucalib.readers import blocks, read
from imucalib.recording.mapping import FieldMapping
from imucalib.units import STANDARD_GRAVITY
from worlds.logger_files import old_gt3x
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
    log, counts = made([0, 1, 2, *range(7, 30)], kind=kind)
    path = archive(tmp_path / "a.gt3x", log)
    recording = read(path)
    channel = recording.channels["imu0/acceleration"]
    np.testing.assert_allclose(channel.values, counts / 256.0 * STANDARD_GRAVITY, rtol=1e-12)
    np.testing.assert_allclose(channel.t[[0, 29, 30, 90]], [0.0, 29 / 30, 1.0, 7.0])
    assert [(g.start, g.stop) for g in recording.gaps] == [(pytest.approx(89 / 30), 7.0)]
    assert recording.start_ns == (START - 7200) * 1_000_000_000
    parts = list(blocks(path, block_samples=40))
    assert len(parts) > 3
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


GT3X_OLD_START = datetime(2011, 10, 26, 9, 0, tzinfo=UTC)


def counts(n: int) -> np.ndarray:
    return np.array([5, 7, 341]) + np.random.default_rng(n).integers(-9, 9, size=(n, 3))


def saved(folder: Path, data: bytes) -> Path:
    path = folder / "a.gt3x"
    path.write_bytes(data)
    return path


def test_the_makers_example(tmp_path: Path) -> None:
    """The three samples that ActiGraph's description of activity.bin works out."""
    path = saved(tmp_path, old_gt3x([], GT3X_OLD_START))
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("info.txt", "Sample Rate: 30\nStart Date: 634556532600000000\n")
        file.writestr("activity.bin", bytes.fromhex("006008EBD007009EBF007008EBF0"))
    found = read(path, FieldMapping(acc_unit="g"))
    g = found.channels["imu0/acceleration"].values / STANDARD_GRAVITY
    wanted = [[0.023, 0.018, -0.947], [0.026, 0.021, -0.941], [0.023, 0.021, -0.947 + 0.006]]
    np.testing.assert_allclose(g, wanted, atol=0.0006)


@pytest.mark.parametrize("n", [900, 901])
def test_values_times_and_blocks(n: int, tmp_path: Path) -> None:
    wanted = counts(n)
    path = saved(tmp_path, old_gt3x(wanted.tolist(), GT3X_OLD_START))
    found = read(path)
    acc = found.channels["imu0/acceleration"]
    np.testing.assert_allclose(acc.values, wanted / 341.0 * STANDARD_GRAVITY, rtol=1e-12)
    np.testing.assert_allclose(acc.t, np.arange(n) / 30.0, atol=1e-9)
    assert found.start_ns == round(GT3X_OLD_START.timestamp()) * 10**9
    assert found.gaps == ()
    assert "ActiGraph NEO1C16110020, 30 Hz, 341 counts a g" in found.notes
    parts = [b.channels["imu0/acceleration"] for b in blocks(path, block_samples=100)]
    assert len(parts) > 5
    np.testing.assert_array_equal(np.concatenate([p.values for p in parts]), acc.values)
    np.testing.assert_allclose(np.concatenate([p.t for p in parts]), acc.t, atol=1e-9)


def test_a_flipped_bit_is_told(tmp_path: Path) -> None:
    data = bytearray(old_gt3x(counts(900).tolist(), GT3X_OLD_START))
    data[data.index(b"activity.bin") + 400] ^= 1
    path = saved(tmp_path, bytes(data))
    with pytest.raises(UnreadableInput):
        read(path, strict=True)
    try:
        notes = read(path).notes
    except UnreadableInput as error:
        notes = (str(error),)
    assert any("breaks off" in note or "no samples" in note for note in notes), notes


class _Pipe(io.BytesIO):
    """What cannot be written again: zipfile puts sizes and checksums behind each member."""

    def seekable(self) -> bool:
        return False

    def seek(self, *where: int) -> int:
        raise OSError


def _archive(activity: bytes, method: int, *, piped: bool) -> bytes:
    out = _Pipe() if piped else io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as file:
        file.writestr("info.txt", "Sample Rate: 30\nStart Date: 634556532600000000\n")
        file.writestr("activity.bin", activity)
        file.writestr("lux.bin", b"")
    return out.getvalue()


@pytest.mark.parametrize(
    ("method", "piped"),
    [(zipfile.ZIP_STORED, False), (zipfile.ZIP_DEFLATED, False), (zipfile.ZIP_DEFLATED, True)],
)
def test_a_lost_directory_is_told_and_the_checksum_holds(
    method: int, piped: bool, tmp_path: Path
) -> None:
    data = _archive(np.random.default_rng(0).bytes(9 * 400), method, piped=piped)
    directory = data.index(b"PK\x01\x02")
    whole, cut = (read(saved(tmp_path, d)) for d in (data, data[:directory]))
    assert any("lost its directory" in note for note in cut.notes)
    assert not any("breaks off" in note for note in cut.notes)
    one, other = (r.channels["imu0/acceleration"].values for r in (whole, cut))
    np.testing.assert_array_equal(one, other)
    with pytest.raises(UnreadableInput, match="no directory"):
        read(path := saved(tmp_path, data[:directory]), strict=True)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        crc = archive.getinfo("activity.bin").CRC.to_bytes(4, "little")
    path.write_bytes(data[:directory].replace(crc, b"\x5a" * 4))
    assert any("checksum" in note for note in read(path).notes)


@pytest.mark.parametrize("line", ["Start Date: 9e9", f"Start Date: {10**40}", "Sample Rate: inf"])
def test_nonsense_in_info_is_refused(line: str, tmp_path: Path) -> None:
    path = tmp_path / "a.gt3x"
    with zipfile.ZipFile(path, "w") as file:
        rows = {"Sample Rate": "30", "Start Date": "634556532600000000"}
        name, _, value = line.partition(": ")
        rows[name] = value
        file.writestr("info.txt", "".join(f"{k}: {v}\n" for k, v in rows.items()))
        file.writestr("activity.bin", bytes.fromhex("006008EBD007009EBF007008EBF0"))
    with pytest.raises(UnreadableInput, match=r"sample rate|start date"):
        read(path)
