"""Damaged MCAP files: what is intact is read, what is not is reported, nothing else is raised."""

from __future__ import annotations

import json
import tarfile
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from imucalib.errors import UnreadableInput
from imucalib.readers import blocks, read
from imucalib.readers.mcap import McapLog
from imucalib.recording.recording import Recording
from worlds.mcap_logs import imu_log, readings, same_bits, values
from worlds.places import MEASURED

Message = tuple[int, int, int, int, bytes]


def messages(path: Path) -> tuple[list[Message], McapLog]:
    """Channel, sequence, log time, publish time and payload of every message."""
    scanner = McapLog(path)
    found: list[Message] = []
    for block in scanner.blocks():
        names = ("channel", "sequence", "log_time", "publish_time")
        columns = [block.header(name).tolist() for name in names]
        found += list(zip(*columns, block.payloads(), strict=True))
    return found, scanner


def chunk_spans(path: Path) -> list[tuple[int, int]]:
    """First byte and end of every chunk record, by the official reader."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    indexes = [(c.chunk_start_offset, c.chunk_length) for c in summary.chunk_indexes]
    return sorted((at, at + length) for at, length in indexes)


def flip(path: Path, at: int, bit: int = 1) -> bytearray:
    """Change a file's byte; returns what the file then holds."""
    data = bytearray(path.read_bytes())
    data[at] ^= bit
    path.write_bytes(data)
    return data


def test_conformance_suite(tmp_path: Path) -> None:
    with tarfile.open(MEASURED / "mcap_conformance.tar.xz") as packed:
        if hasattr(tarfile, "data_filter"):  # Python 3.11.4 and later, which else warns
            packed.extraction_filter = tarfile.data_filter
        packed.extractall(tmp_path)
    seen = 0
    for expected in sorted(tmp_path.rglob("*.json")):
        records = json.loads(expected.read_text())["records"]
        fields = [dict(r["fields"]) for r in records if r["type"] == "Message"]
        names = ("channel_id", "sequence", "log_time", "publish_time")
        want = [(*(int(f[n]) for n in names), bytes(map(int, f["data"]))) for f in fields]
        topics = {
            int(f["id"]): f["topic"]
            for f in (dict(r["fields"]) for r in records if r["type"] == "Channel")
        }
        found, scanner = messages(expected.with_suffix(".mcap"))
        assert found == want, expected
        assert {n: t.name for n, t in scanner.topics.items()} == topics, expected
        assert scanner.damages == [], expected
        seen += 1
    assert seen == 416


def test_data_section_crc_finds_what_no_chunk_protects(tmp_path: Path) -> None:
    path = imu_log(tmp_path / "a.mcap", 50, use_chunking=False, enable_data_crcs=True)
    assert messages(path)[1].damages == []
    flip(path, path.stat().st_size // 3)
    assert "CRC of the whole data section" in str(messages(path)[1].damages)


def by_chunk(path: Path) -> list[list[bytes]]:
    """Payloads by chunk."""
    return [block.payloads() for block in McapLog(path).blocks()]


def test_a_bad_chunk_costs_only_itself(tmp_path: Path) -> None:
    path = imu_log(tmp_path / "a.mcap", 1000)
    sizes = [len(part) for part in by_chunk(path)]
    start, stop = chunk_spans(path)[3]
    flip(path, (start + stop) // 2)
    recording = read(path)
    lost = slice(sum(sizes[:3]), sum(sizes[:4]))
    kept = np.delete(np.arange(1000), lost)
    channel = recording.channels["imu0/acceleration"]
    assert same_bits(channel.values, values(readings(1000), "acc")[kept])
    (gap,) = recording.gaps
    assert gap.start == pytest.approx((lost.start - 1) * 1e-3)
    assert gap.stop == pytest.approx(lost.stop * 1e-3)
    assert gap.reason == "imu0: a damaged part of the file"
    assert any(
        f"byte {start}: " in note and f"{sizes[3]} messages" in note for note in recording.notes
    )
    assert_same_in_blocks(path, recording)
    with pytest.raises(UnreadableInput, match=f"damaged at byte {start}"):
        read(path, strict=True)
    with pytest.raises(UnreadableInput, match=f"damaged at byte {start}"):
        list(blocks(path, strict=True))


def assert_same_in_blocks(path: Path, whole: Recording) -> None:
    pieces = list(blocks(path, block_samples=100))
    joined = np.concatenate([p.channels["imu0/acceleration"].values for p in pieces])
    assert same_bits(joined, whole.channels["imu0/acceleration"].values)
    assert tuple(gap for piece in pieces for gap in piece.gaps) == whole.gaps
    assert tuple(note for piece in pieces for note in piece.notes) == whole.notes


def test_losing_the_chunk_that_defines_the_topic(tmp_path: Path) -> None:
    path = imu_log(tmp_path / "a.mcap", 500)
    first = len(by_chunk(path)[0])
    start, stop = chunk_spans(path)[0]
    data = flip(path, (start + stop) // 2)
    channel = read(path).channels["imu0/acceleration"]
    assert same_bits(channel.values, values(readings(500), "acc")[first:])
    path.write_bytes(data[:-100])  # without the summary nobody knows what the messages are
    with pytest.raises(UnreadableInput, match="no IMU topic"):
        read(path)


def test_unchunked_file_resumes_after_damage(tmp_path: Path) -> None:
    path = imu_log(tmp_path / "a.mcap", 300, use_chunking=False)
    intact, _ = messages(path)
    data = bytearray(path.read_bytes())
    at = len(data) // 2
    data[at : at + 40] = b"\xff" * 40
    at = data.index(b"\x05", at + 2000)
    data[at + 1 : at + 9] = b"\xff" * 8
    path.write_bytes(data)
    found, scanner = messages(path)
    assert len(found) >= 290
    assert len(set(found) - set(intact)) <= 1  # its 40 bytes lie in a payload that no CRC covers
    assert scanner.damages
