"""Recordings written to MCAP: read back bit for bit, readable by others, other topics kept."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from imucalib.errors import UsageError
from imucalib.readers import read
from imucalib.readers.mcap import McapLog
from imucalib.recording.mapping import FieldMapping, from_dict
from imucalib.recording.recording import Channel, Recording
from imucalib.writers import write
from imucalib.writers.mcap_over import write_with_topics_of
from worlds.mcap_logs import (
    IMU_ROS1,
    IMU_ROS2,
    START,
    cdr,
    messages_of,
    packed,
    readings,
    ros1,
    same_bits,
    write_log,
)
from worlds.places import SAMPLES


def recording(
    triads: list[str], count: int, *, seed: int = 0, start_ns: int | None = START, unit: str = ""
) -> Recording:
    """Random triads at 200 Hz whose times are whole nanoseconds."""
    rng = np.random.default_rng(seed)
    channels = {}
    for i, triad in enumerate(triads):
        t = (np.arange(count) * 5_000_000 + i * 1000) * 1e-9
        acc = rng.normal((0, 0, 9.8), 0.05, (count, 3))
        for name, values, own in (
            ("acceleration", acc, "m/s2"),
            ("angular_rate", acc * 0, "rad/s"),
        ):
            kind = unit or own
            channels[f"{triad}/{name}"] = Channel(t, values, kind, name, triad, 200.0)
    return Recording(channels, "made", "made", "", start_ns)


def assert_equal(a: Recording, b: Recording) -> None:
    assert a.channels.keys() == b.channels.keys()
    assert a.start_ns == b.start_ns
    for name, channel in a.channels.items():
        other = b.channels[name]
        assert same_bits(channel.t, other.t)
        assert same_bits(channel.values, other.values)
        assert (channel.unit, channel.quantity, channel.triad) == (
            other.unit, other.quantity, other.triad,
        )  # fmt: skip
        assert other.rate == pytest.approx(channel.rate)


@settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    triads=st.lists(st.sampled_from(["imu0", "imu10", "left_foot", "b"]), min_size=1, unique=True),
    count=st.integers(2, 3000),
    start_ns=st.sampled_from([START, None]),
    unit=st.sampled_from(["", "counts"]),
)
def test_round_trip(
    tmp_path: Path, triads: list[str], count: int, start_ns: int | None, unit: str
) -> None:
    made = recording(triads, count, start_ns=start_ns, unit=unit)
    write(made, tmp_path / "a.mcap")
    back = read(tmp_path / "a.mcap", strict=True)
    assert_equal(made, back)
    assert back.gaps == ()


def test_read_by_the_official_reader(tmp_path: Path) -> None:
    made = recording(["a", "b2"], 4000)
    path = tmp_path / "a.mcap"
    write(made, path)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 8000
        assert len(summary.chunk_indexes) == summary.statistics.chunk_count > 1
        found = list(reader.iter_decoded_messages())
    assert [m.log_time for _, _, m, _ in found] == sorted(m.log_time for _, _, m, _ in found)
    acc = np.array(
        [
            (d.linear_acceleration.x, d.linear_acceleration.y, d.linear_acceleration.z)
            for _, c, _, d in found
            if c.topic == "/b2/imu"
        ]
    )
    assert same_bits(acc, made.channels["b2/acceleration"].values)
    first = found[0][3]
    assert (first.header.frame_id, first.orientation_covariance[0]) == ("a", -1.0)
    assert first.header.stamp.sec * 10**9 + first.header.stamp.nanosec == START


def by_rosbags(path: Path) -> list[tuple[str, object]]:
    """Topic and message, of every message."""
    with AnyReader([path]) as bag:
        return [(c.topic, bag.deserialize(raw, c.msgtype)) for c, _, raw in bag.messages()]


def by_the_official_reader(path: Path) -> list[tuple[str, object]]:
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return [(c.topic, message) for _, c, _, message in reader.iter_decoded_messages()]


READERS = [by_rosbags, by_the_official_reader]
PARTS = {"acceleration": "linear_acceleration", "angular_rate": "angular_velocity"}


@pytest.mark.parametrize("loaded", READERS)
@pytest.mark.parametrize("absent", PARTS)
@pytest.mark.parametrize("unit", ["", "counts"])
def test_what_was_not_measured_is_said_to_be_absent(
    loaded: Callable[[Path], list[tuple[str, Any]]], absent: str, unit: str, tmp_path: Path
) -> None:
    """covariance[0] = -1: "no estimate for one of the data elements" (sensor_msgs/msg/Imu)."""
    made = recording(["a"], 50, unit=unit)
    there = {n: c for n, c in made.channels.items() if c.quantity != absent}
    path = tmp_path / "a.mcap"
    write(replace(made, channels=there), path)
    found = loaded(path)
    assert len(found) == 50
    for _, message in found:
        for quantity, field in PARTS.items():
            covariance = list(getattr(message, f"{field}_covariance"))
            assert covariance == [-1.0 if quantity == absent else 0.0] + [0.0] * 8
    assert_equal(replace(made, channels=there), read(path, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("loaded", READERS)
@pytest.mark.parametrize("name", sorted(p.name for p in SAMPLES.glob("*.mcap")))
def test_others_read_the_sample_logs_and_what_is_written_over_them(
    loaded: Callable[[Path], list[tuple[str, Any]]], name: str, tmp_path: Path
) -> None:
    whole = read(SAMPLES / name)
    write_with_topics_of(whole, SAMPLES / name, tmp_path / "over.mcap")
    write(whole, tmp_path / "anew.mcap")
    rows = sum(c.t.size for c in whole.channels.values() if c.quantity == "acceleration")
    for path in (SAMPLES / name, tmp_path / "over.mcap", tmp_path / "anew.mcap"):
        assert len(loaded(path)) == rows


def raw_messages(path: Path) -> list[tuple[str, int, int, int, bytes]]:
    """Topic, sequence, times and payload of every message, in file order."""
    log = McapLog(path, strict=True)
    return [(log.topics[number].name, *rest) for number, *rest in messages_of(log)]


@pytest.mark.parametrize("date", [START, 4 * 10**9])
def test_other_topics_are_copied_untouched(tmp_path: Path, date: int) -> None:
    rows = [replace(r, ns=r.ns - START + date) for r in readings(500)]
    logs = {
        "/imu/data": [(START + i, cdr(r)) for i, r in enumerate(rows)],
        "/odd": [(START + 500 * i, bytes([i]) * (i + 1)) for i in range(200)],
        "/imu/raw": packed(readings(300, seed=4), cdr),
    }
    source = write_log(tmp_path / "a.mcap", logs)
    del logs["/imu/raw"], logs["/imu/data"]
    whole = read(write_log(tmp_path / "b.mcap", {"/imu/data": packed(rows, cdr)}))
    channels = {n: replace(c, values=c.values * 1.01) for n, c in whole.channels.items()}
    write_with_topics_of(replace(whole, channels=channels), source, tmp_path / "c.mcap")
    before, after = (set(raw_messages(p)) for p in (source, tmp_path / "c.mcap"))
    replaced = {m for m in before if m[0] == "/imu/data"}
    assert before - replaced <= after
    assert len(after) == len(before)
    times = [m[2] for m in after]
    assert max(times) - min(times) < 10**9
    back = read(tmp_path / "c.mcap", FieldMapping(acc=("/imu/data",)))
    assert same_bits(
        back.channels["imu0/acceleration"].values, channels["imu0/acceleration"].values
    )
    assert back.start_ns == whole.start_ns


PACKINGS = {
    "cdr": (cdr, "<"),
    "cdr big-endian": (lambda r: cdr(r, order=">"), ">"),
    "cdr 2": (lambda r: cdr(r, version=2), "<"),
    "ros1": (ros1, "<"),
}


@pytest.mark.parametrize("packing", PACKINGS)
def test_corrected_messages_keep_all_their_other_bytes(tmp_path: Path, packing: str) -> None:
    pack, order = PACKINGS[packing]
    rows = readings(400)
    rows = [replace(r, frame="imu_link"[: 3 + i % 3]) for i, r in enumerate(rows)]
    rows[100], rows[130] = rows[130], rows[100]  # stamps step back
    old = packing == "ros1"
    schema = ("sensor_msgs/Imu", "ros1msg", IMU_ROS1.encode())
    options = {"schema": schema, "encoding": "ros1"} if old else {}
    logs = {"/imu/data": [(START + 7 * i, pack(r)) for i, r in enumerate(rows)]}
    source = write_log(tmp_path / "a.mcap", logs, chunk_size=9000, **options)
    whole = read(source)
    channels = {
        n: replace(c, values=c.values * 1.5 + 1) if "acceleration" in n else c
        for n, c in whole.channels.items()
    }
    write_with_topics_of(replace(whole, channels=channels), source, tmp_path / "c.mcap")
    before, after = raw_messages(source), raw_messages(tmp_path / "c.mcap")
    assert len(before) == len(after) == 400
    for one, two, reading in zip(before, after, rows, strict=True):
        (*head, payload), (*same, patched) = one, two
        assert head == same
        tail = struct.pack(f"{order}3d", *(np.array(reading.acc) * 1.5 + 1))
        at = len(payload) - 12 * 8
        assert patched == payload[:at] + tail + payload[at + 24 :]
    back = read(tmp_path / "c.mcap", strict=True)
    for name, channel in channels.items():
        assert same_bits(back.channels[name].values, channel.values)
        assert same_bits(back.channels[name].t, channel.t)


def set_back(count: int) -> list[tuple[int, bytes]]:
    """Messages whose clock was set back by seconds on the way."""
    rows = [replace(r, ns=r.ns - (3_600_000_000 if i >= 200 else 0))
            for i, r in enumerate(readings(count, rate=100.0))]  # fmt: skip
    return packed(rows, cdr)


def packed_alone(count: int) -> list[tuple[int, bytes]]:
    """Messages that are compressed one by one, which are written anew."""
    return packed(readings(count), lambda r: zstandard.compress(cdr(r)))


def out_of_order(count: int) -> list[tuple[int, bytes]]:
    """Messages that are stored in another order than that of their times."""
    order = np.random.default_rng(0).permutation(count).tolist()
    made = packed(readings(count, rate=100.0), cdr)
    return [made[k] for k in order]


@pytest.mark.parametrize("messages", [set_back, packed_alone, out_of_order])
def test_every_message_gets_its_own_vector(
    messages: Callable[[int], list[tuple[int, bytes]]], tmp_path: Path
) -> None:
    source = write_log(tmp_path / "a.mcap", {"/imu/data": messages(400)}, in_order=False)
    whole = read(source)
    channels = {n: replace(c, values=c.values * 2.0) for n, c in whole.channels.items()}
    write_with_topics_of(replace(whole, channels=channels), source, tmp_path / "c.mcap")
    back = read(tmp_path / "c.mcap", from_dict(whole.mapping))
    for name, channel in channels.items():
        assert same_bits(back.channels[name].values, channel.values)


def test_two_publishers_of_a_topic_keep_its_name(tmp_path: Path) -> None:
    source = tmp_path / "a.mcap"
    with source.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        kind = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", IMU_ROS2.encode())
        channels = [writer.register_channel("/imu", "cdr", kind) for _ in range(2)]
        for one, other in zip(readings(300), readings(300, seed=1), strict=True):
            for channel, reading in zip(channels, (one, other), strict=True):
                writer.add_message(channel, reading.ns, cdr(reading), reading.ns)
        writer.finish()
    whole = read(source)
    twice = {n: replace(c, values=c.values * 2.0) for n, c in whole.channels.items()}
    write_with_topics_of(replace(whole, channels=twice), source, tmp_path / "c.mcap")
    back = read(tmp_path / "c.mcap")
    assert len(back.channels) == 4
    for name, channel in twice.items():
        assert same_bits(back.channels[name].values, channel.values)
    with (tmp_path / "c.mcap").open("rb") as stream:
        assert {c.topic for _, c, _ in make_reader(stream).iter_messages()} == {"/imu"}


def test_attachments_metadata_and_a_thermometer_are_kept(tmp_path: Path) -> None:
    source = tmp_path / "a.mcap"
    made = recording(["imu0"], 300)
    warm = Channel(np.arange(30) * 0.05, np.full((30, 1), 21.5), "degC", "temperature", "imu0", 20)
    write(replace(made, channels={**made.channels, "imu0/temperature": warm}), source)
    note = b"a photo of the bench" * 50
    packed_file = tmp_path / "b.mcap"
    with source.open("rb") as old, packed_file.open("wb") as new:
        writer = Writer(new)
        writer.start("ros2")
        reader = make_reader(old)
        numbers: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            if channel.id not in numbers:
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                meta = dict(channel.metadata)
                numbers[channel.id] = writer.register_channel(channel.topic, "cdr", kind, meta)
            writer.add_message(
                numbers[channel.id], message.log_time, message.data, message.publish_time
            )
        writer.add_attachment(5, 6, "bench.jpg", "image/jpeg", note)
        writer.add_metadata("rig", {"table": "7", "operator": "x"})
        writer.finish()
    whole = read(packed_file)
    assert "imu0/temperature" in whole.channels
    write_with_topics_of(whole, packed_file, tmp_path / "c.mcap")
    with (tmp_path / "c.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        (kept,) = reader.iter_attachments()
        assert (kept.name, kept.media_type, kept.data) == ("bench.jpg", "image/jpeg", note)
        assert {kept.log_time, kept.create_time} == {5, 6}
        (metadata,) = reader.iter_metadata()
        assert (metadata.name, metadata.metadata) == ("rig", {"table": "7", "operator": "x"})
        statistics = reader.get_summary().statistics
        assert (statistics.attachment_count, statistics.metadata_count) == (1, 1)
    assert set(raw_messages(tmp_path / "c.mcap")) == set(raw_messages(packed_file))
    assert_equal(whole, read(tmp_path / "c.mcap", strict=True))


def test_a_channel_without_a_message_is_refused_and_nothing_is_left(tmp_path: Path) -> None:
    made = recording(["imu0"], 10)
    odd = Channel(np.arange(3.0), np.ones((3, 2)), "T", "magnetic_field", "imu0", 1.0)
    target = tmp_path / "a.mcap"
    target.write_bytes(b"old")
    with pytest.raises(UsageError, match="imu0/magnetic_field"):
        write(replace(made, channels={**made.channels, "imu0/magnetic_field": odd}), target)
    assert target.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]
