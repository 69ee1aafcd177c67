"""MCAP messages to channels: equal to the official decoder; clocks, choices; damage is reported."""

from __future__ import annotations

import json
import tarfile
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap_ros2.decoder import DecoderFactory

from imucalib import units
from imucalib.errors import UnreadableInput, UsageError
from imucalib.readers import blocks, read
from imucalib.readers.mcap import McapLog
from imucalib.recording.mapping import FieldMapping, from_dict
from imucalib.recording.recording import Recording
from worlds.mcap_logs import (
    HEADER_ROS2,
    SEPARATOR,
    START,
    Reading,
    cdr,
    imu_log,
    messages_of,
    official_cdr,
    packed,
    readings,
    same_bits,
    values,
    write_log,
)
from worlds.places import MEASURED

COMPRESSIONS = [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD]


def official(path: Path, topic: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps (ns), acceleration and angular rate by the official decoder."""
    stamps, acc, gyro = [], [], []
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = reader.iter_decoded_messages(topics=[topic], log_time_order=False)
        for _, _, _, message in found:
            stamp, a, w = (
                message.header.stamp,
                message.linear_acceleration,
                message.angular_velocity,
            )
            stamps.append(stamp.sec * 10**9 + stamp.nanosec)
            acc.append((a.x, a.y, a.z))
            gyro.append((w.x, w.y, w.z))
    return np.array(stamps), np.array(acc), np.array(gyro)


def assert_equals_official(recording: Recording, path: Path, topics: list[str]) -> None:
    for i, topic in enumerate(topics):
        stamps, acc, gyro = official(path, topic)
        channel = recording.channels[f"imu{i}/acceleration"]
        assert same_bits(channel.values, acc)
        assert same_bits(recording.channels[f"imu{i}/angular_rate"].values, gyro)
        assert recording.start_ns is not None
        assert np.array_equal(np.rint(channel.t * 1e9).astype(int) + recording.start_ns, stamps)


def assert_same(a: Recording, b: Recording) -> None:
    assert a.channels.keys() == b.channels.keys()
    for name, channel in a.channels.items():
        assert same_bits(channel.t, b.channels[name].t)
        assert same_bits(channel.values, b.channels[name].values)
        assert channel.unit == b.channels[name].unit


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("count", [1, 4])
@pytest.mark.parametrize("chunked", [True, False])
def test_equals_official_decoder(
    tmp_path: Path, compression: CompressionType, count: int, chunked: bool
) -> None:
    topics = [f"/imu{i}/data" for i in range(count)]
    logs = {
        topic: packed(readings(300, seed=i, frame="imu" + "x" * i), official_cdr, delay=i)
        for i, topic in enumerate(topics)
    }
    path = write_log(tmp_path / "a.mcap", logs, compression=compression, use_chunking=chunked)
    recording = read(path, strict=True)
    assert len(recording.channels) == 2 * count
    assert recording.gaps == ()
    assert_equals_official(recording, path, topics)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("frame", ["", "imu", "imulink", "base_link"])
def test_every_plain_cdr(tmp_path: Path, order: str, version: int, frame: str) -> None:
    rows = readings(300, frame=frame)
    logs = {"/imu": packed(rows, lambda r: cdr(r, order, version))}
    recording = read(write_log(tmp_path / "a.mcap", logs), strict=True)
    assert same_bits(recording.channels["imu0/acceleration"].values, values(rows, "acc"))
    assert same_bits(recording.channels["imu0/angular_rate"].values, values(rows, "gyro"))
    assert recording.start_ns == START
    if version == 1:
        assert_equals_official(recording, tmp_path / "a.mcap", ["/imu"])


def test_split_topics_become_one_triad(tmp_path: Path) -> None:
    zero = (0.0, 0.0, 0.0)
    acc = [Reading(r.ns, r.acc, zero) for r in readings(250, rate=250.0)]
    gyro = [Reading(r.ns, zero, r.gyro) for r in readings(400, rate=400.0)]
    logs = {"/camera/gyro/sample": packed(gyro, cdr), "/camera/accel/sample": packed(acc, cdr)}
    recording = read(write_log(tmp_path / "a.mcap", logs))
    assert set(recording.channels) == {"imu0/acceleration", "imu0/angular_rate"}
    assert same_bits(recording.channels["imu0/acceleration"].values, values(acc, "acc"))
    assert same_bits(recording.channels["imu0/angular_rate"].values, values(gyro, "gyro"))
    assert recording.channels["imu0/angular_rate"].rate == pytest.approx(400.0)
    assert recording.mapping["acc"] == ["/camera/accel/sample:linear_acceleration"]
    assert recording.mapping["gyro"] == ["/camera/gyro/sample:angular_velocity"]


# -- clocks -----------------------------------------------------------------------------------


def timed(path: Path, stamps: list[int], logs: list[int]) -> Recording:
    rows = readings(len(stamps))
    pairs = [
        (log, cdr(Reading(ns, r.acc, r.gyro)))
        for ns, log, r in zip(stamps, logs, rows, strict=True)
    ]
    return read(write_log(path, {"/imu": pairs}))


@pytest.mark.parametrize("stamp", [0, START])
def test_useless_stamps_fall_back_to_log_time(tmp_path: Path, stamp: int) -> None:
    logs = [START + i * 5_000_000 for i in range(100)]
    recording = timed(tmp_path / "a.mcap", [stamp] * 100, logs)
    assert recording.channels["imu0/acceleration"].rate == pytest.approx(200.0)
    assert recording.start_ns == START
    assert any("time from log_time: the stamp" in note for note in recording.notes)


def batched(stamps: list[int], each: int) -> list[int]:
    """As a driver stamps that reads a buffer of `each` samples."""
    return [stamps[i // each * each] for i in range(len(stamps))]


def test_samples_that_share_a_stamp_are_spread_to_the_next(tmp_path: Path) -> None:
    true = [START + i * 5_000_000 for i in range(300) if not 100 <= i < 150]
    recording = timed(tmp_path / "a.mcap", batched(true, 10), [s + 7 for s in true])
    channel = recording.channels["imu0/acceleration"]
    assert channel.rate == pytest.approx(200.0)
    np.testing.assert_allclose(channel.t, (np.array(true) - START) * 1e-9, atol=1e-9)
    assert [(g.start, g.stop) for g in recording.gaps] == [
        (pytest.approx(0.495), pytest.approx(0.75))
    ]
    assert any("--time log_time" in note for note in recording.notes)
    pieces = list(blocks(tmp_path / "a.mcap", block_samples=64))
    assert len(pieces) > 1
    joined = np.concatenate([p.channels["imu0/acceleration"].t for p in pieces])
    np.testing.assert_array_equal(joined, channel.t)


# -- field paths ------------------------------------------------------------------------------


def json_log(path: Path, trees: list[object], step: int = 10_000_000) -> Path:
    pairs = [(START + i * step, json.dumps(tree).encode()) for i, tree in enumerate(trees)]
    return write_log(path, {"/imu": pairs}, schema=("Imu", "jsonschema", b"{}"), encoding="json")


def test_json_by_names_and_unit_by_norm(tmp_path: Path) -> None:
    rows = readings(400, rate=100.0)
    g = units.STANDARD_GRAVITY
    trees = [
        {
            "timestamp": (r.ns - START) / 1e6,
            "data": {
                "accel": [v / g for v in r.acc],
                "gyro": dict(zip("xyz", r.gyro, strict=True)),
            },
        }
        for r in rows
    ]
    recording = read(json_log(tmp_path / "a.mcap", trees))
    assert np.allclose(
        recording.channels["imu0/acceleration"].values, values(rows, "acc"), atol=1e-12
    )
    assert recording.channels["imu0/angular_rate"].unit == "counts"
    assert any("-> unit g" in note for note in recording.notes)
    assert recording.channels["imu0/acceleration"].rate == pytest.approx(100.0)
    assert recording.start_ns is None
    assert recording.mapping["acc"] == ["/imu:data.accel"]


@pytest.mark.parametrize("bad", [b"{", b"{},{}", b'{"acc": [1, 2]}', b'{"acc": "none"}'])
def test_a_message_that_cannot_be_read_costs_itself(bad: bytes, tmp_path: Path) -> None:
    rows = readings(100)
    pairs = [(r.ns, json.dumps({"acc": r.acc}).encode()) for r in rows]
    pairs[40] = (pairs[40][0], bad)
    schema = ("Imu", "jsonschema", b"{}")
    path = write_log(tmp_path / "a.mcap", {"/imu": pairs}, schema=schema, encoding="json")
    found = read(path, FieldMapping(acc_unit="m/s2"))
    expected = np.delete(values(rows, "acc"), 40, axis=0)
    assert same_bits(found.channels["imu0/acceleration"].values, expected)
    assert any("1 messages cannot be decoded" in note for note in found.notes)
    with pytest.raises(UnreadableInput, match="topic /imu"):
        read(path, strict=True)


def test_many_triads_in_one_message_and_mapping_reads_again(tmp_path: Path) -> None:
    rows = [readings(200, seed=i, rate=100.0) for i in range(3)]
    trees = [
        {f"s{k}": {"force": list(r.acc)} for k, r in enumerate(group)}
        for group in zip(*rows, strict=True)
    ]
    path = json_log(tmp_path / "a.mcap", trees)
    mapping = FieldMapping(
        acc=("/imu:s0.force", "/imu:s1.force", "/imu:s2.force"),
        acc_unit="m/s2",
        triads=("a", "b", "c"),
    )
    recording = read(path, mapping)
    assert list(recording.channels) == ["a/acceleration", "b/acceleration", "c/acceleration"]
    for name, group in zip("abc", rows, strict=True):
        assert same_bits(recording.channels[f"{name}/acceleration"].values, values(group, "acc"))
    assert_same(read(path, from_dict(recording.mapping)), recording)


def test_px4_names_state_their_units(tmp_path: Path) -> None:
    text = "uint64 timestamp\nfloat32[3] gyro_rad\nfloat32[3] accelerometer_m_s2\n"
    rows = readings(300, rate=250.0)
    data = np.zeros(300, dtype=[("e", "V4"), ("t", "<u8"), ("g", "<f4", 3), ("a", "<f4", 3)])
    data["e"] = np.void(b"\0\1\0\0")
    data["t"] = [(r.ns - START) // 1000 + 9_000_000 for r in rows]
    data["g"], data["a"] = values(rows, "gyro"), values(rows, "acc")
    pairs = [(r.ns, row.tobytes()) for r, row in zip(rows, data, strict=True)]
    schema = ("px4_msgs/msg/SensorCombined", "ros2msg", text.encode())
    recording = read(write_log(tmp_path / "a.mcap", {"/fmu": pairs}, schema=schema))
    channel = recording.channels["imu0/acceleration"]
    assert (channel.unit, recording.channels["imu0/angular_rate"].unit) == ("m/s2", "rad/s")
    assert same_bits(channel.values, data["a"].astype(np.float64))


def test_sequences_and_nested_types(tmp_path: Path) -> None:
    text = f"""string<=8 name
uint8[] blob
Sample[] samples
float32 LIMIT=3.5
{SEPARATOR}
MSG: my/Sample
std_msgs/Header header
float64[3] acc
{HEADER_ROS2}"""
    from mcap_ros2._dynamic import serialize_dynamic

    encode = serialize_dynamic("my/msg/Bundle", text)["my/msg/Bundle"]
    rows = readings(60)
    rng = np.random.default_rng(3)
    pairs = []
    for r in rows:
        stamp = {"sec": r.ns // 10**9, "nanosec": r.ns % 10**9}
        sample = {"header": {"stamp": stamp, "frame_id": "a"}, "acc": list(r.acc)}
        blob = bytes(rng.integers(0, 256, rng.integers(0, 9), dtype=np.uint8))
        pairs.append((r.ns, bytes(encode({"name": "q", "blob": blob, "samples": [sample]}))))
    schema = ("my/msg/Bundle", "ros2msg", text.encode())
    path = write_log(tmp_path / "a.mcap", {"/b": pairs}, schema=schema)
    mapping = FieldMapping(acc=("/b:samples.0.acc",), time="samples.0.header.stamp")
    recording = read(path, mapping, strict=True)
    assert same_bits(recording.channels["imu0/acceleration"].values, values(rows, "acc"))
    assert recording.start_ns == START


def test_protobuf_without_its_package_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "google.protobuf", None)
    logs = {"/imu": [(START, b"\x08\x01")]}
    path = write_log(
        tmp_path / "a.mcap", logs, schema=("p.Imu", "protobuf", b""), encoding="protobuf"
    )
    with pytest.raises(UsageError, match=r"imucalib\[protobuf\]"):
        read(path, FieldMapping(acc=("/imu",)))
    with pytest.raises(UnreadableInput, match="need the protobuf package"):
        read(path)


Message = tuple[int, int, int, int, bytes]


def messages(path: Path) -> tuple[list[Message], McapLog]:
    scanner = McapLog(path)
    return messages_of(scanner), scanner


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


@pytest.mark.parametrize("kept", [0x0F, 0x02])
def test_whole_records_that_are_gone_are_missed(kept: int, tmp_path: Path) -> None:
    """From the last chunk to the end of the data, or to the footer."""
    path = tmp_path / "a.mcap"
    imu_log(path, 400)
    data, places, at = path.read_bytes(), list[tuple[int, int]](), 8
    while at + 9 < len(data) - 8:
        places.append((data[at], at))
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    last = max(place for opcode, place in places if opcode == 0x06)
    to = min(place for opcode, place in places if opcode == kept and place > last)
    path.write_bytes(data[:last] + data[to:])
    found = read(path)
    assert found.channels["imu0/acceleration"].t.size < 400
    assert any("damaged" in note for note in found.notes)
    with pytest.raises(UnreadableInput):
        read(path, strict=True)


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
