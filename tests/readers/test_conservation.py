"""What is in a file is given or named: samples, elements of lists, encodings, publishers, order."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer

from imucalib import readers
from imucalib.arrays import Array
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Recording
from worlds.mcap_logs import IMU_ROS2, START, cdr, readings
from worlds.one_table import FORMATS, N, Table

MS2 = FieldMapping(acc_unit="m/s2")


def force(n: int = N, seed: int = 0) -> Array:
    rng = np.random.default_rng(seed)
    return np.round(np.array([0.0, 0.0, 9.81]) + rng.normal(scale=0.02, size=(n, 3)), 6)


def conserved(found: Recording, held: int, read: int) -> None:
    """Whether the counts add up to what was written, and the notes name what was left out."""
    (count,) = found.counts
    assert (count.held, count.read) == (held, read)
    assert count.held == count.read + sum(count.left.values())
    for left in filter(None, count.left.values()):
        assert any(str(left) in note for note in found.notes)


@pytest.mark.parametrize("write", FORMATS)
def test_samples_without_a_value_are_counted_in_every_format(
    write: Callable[[Path, Table], Path], tmp_path: Path
) -> None:
    acc = force()
    if write.__name__ not in ("written_json", "written_cdr"):  # where NaN is a number like others
        acc[[7, 20, 21], 1] = np.nan
    path = write(tmp_path / "log", dict(zip(("acc_x", "acc_y", "acc_z"), acc.T, strict=True)))
    found = readers.read(path)
    conserved(found, N, int(np.isfinite(acc).all(axis=1).sum()))
    assert found.channels["imu0/acceleration"].t.size == found.counts[0].read


@pytest.mark.parametrize("bad", ["a,b,c,d", "0.07,1,2", ",,,", "0.07,,1,2"])
def test_every_row_of_a_table_is_counted(bad: str, tmp_path: Path) -> None:
    rows = [f"{k / 100},{','.join(map(repr, v))}" for k, v in enumerate(force().tolist())]
    rows[7] = bad
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["time,acc_x,acc_y,acc_z", *rows]) + "\n")
    conserved(readers.read(path), N, N - 1)


def logged(path: Path, messages: Iterable[tuple[str, int, Any]]) -> Path:
    """A log of (channel, log time in ns, JSON content or the bytes of an Imu); a channel's topic is
    what comes before its #."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        kinds = {
            "json": writer.register_schema("Own", "jsonschema", b"{}"),
            "cdr": writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", IMU_ROS2.encode()),
        }
        channels: dict[str, int] = {}
        for name, ns, content in messages:
            kind = "cdr" if isinstance(content, bytes) else "json"
            if name not in channels:
                topic = name.partition("#")[0]
                channels[name] = writer.register_channel(topic, kind, kinds[kind])
            data = content if isinstance(content, bytes) else json.dumps(content).encode()
            writer.add_message(channels[name], START + ns, data, START + ns)
        writer.finish()
    return path


STEP = 10_000_000


def test_every_element_of_a_list_is_a_sample(tmp_path: Path) -> None:
    acc = force()
    elements = [{"t": k / 100, "acc": v} for k, v in enumerate(acc.tolist())]
    messages = [("/imu", k * STEP, {"samples": elements[k : k + 10]}) for k in range(0, N, 10)]
    found = readers.read(logged(tmp_path / "log.mcap", messages), MS2)
    conserved(found, N, N)
    channel = found.channels["imu0/acceleration"]
    np.testing.assert_array_equal(channel.values, acc)
    np.testing.assert_allclose(np.diff(channel.t), 0.01, atol=1e-9)


def test_lists_that_differ_in_length_are_read(tmp_path: Path) -> None:
    acc = force(60).tolist()
    cuts = [0, 1, 11, 11, 40, 60]
    messages = [
        ("/imu", a * STEP, {"stamp": a / 100, "samples": [{"acc": v} for v in acc[a:b]]})
        for a, b in pairwise(cuts)
    ]
    found = readers.read(logged(tmp_path / "log.mcap", messages), MS2)
    assert found.channels["imu0/acceleration"].values.tolist() == acc


def test_publishers_at_the_same_time_are_sensors_of_their_own(tmp_path: Path) -> None:
    one, two = force(seed=1), force(seed=2)[:, ::-1]
    messages = [
        (f"/imu#{number}", k * STEP + number * 3_000_000, {"acc": acc[k].tolist()})
        for k in range(N)
        for number, acc in enumerate((one, two))
    ]
    path = logged(tmp_path / "log.mcap", messages)
    found = readers.read(path, MS2)
    np.testing.assert_array_equal(found.channels["imu0/acceleration"].values, one)
    np.testing.assert_array_equal(found.channels["imu1/acceleration"].values, two)
    blocks = readers.blocks(path, MS2, block_samples=50)
    name = "imu1/acceleration"
    values = [b.channels[name].values for b in blocks if name in b.channels]
    np.testing.assert_array_equal(np.concatenate(values), two)
    again = readers.read(path, FieldMapping(acc=("/imu#2",), acc_unit="m/s2"))
    np.testing.assert_array_equal(again.channels["imu0/acceleration"].values, two)


def test_publishers_after_each_other_are_one_sensor(tmp_path: Path) -> None:
    acc = force().tolist()
    messages = [(f"/imu#{k // 200}", k * STEP, {"acc": acc[k]}) for k in range(N)]
    found = readers.read(logged(tmp_path / "log.mcap", messages), MS2)
    conserved(found, N, N)
    assert found.channels["imu0/acceleration"].values.tolist() == acc


@pytest.mark.parametrize("first", ["cdr", "json"])
def test_a_second_encoding_of_a_topic_is_read(first: str, tmp_path: Path) -> None:
    imu = readings(N, rate=100.0)

    def content(k: int) -> Any:
        if (k < N // 2) == (first == "cdr"):
            return cdr(imu[k])
        stamp = {"sec": imu[k].ns // 10**9, "nanosec": imu[k].ns % 10**9}
        vectors = {"linear_acceleration": imu[k].acc, "angular_velocity": imu[k].gyro}
        named = {name: dict(zip("xyz", v, strict=True)) for name, v in vectors.items()}
        return {"header": {"stamp": stamp}, **named}

    messages = [(f"/imu#{2 * k // N}", k * STEP, content(k)) for k in range(N)]
    found = readers.read(logged(tmp_path / "log.mcap", messages))
    conserved(found, N, N)
    assert found.channels["imu0/acceleration"].values.tolist() == [list(r.acc) for r in imu]
    assert found.channels["imu0/acceleration"].unit == "m/s2"


def test_a_second_encoding_that_lacks_a_field_is_counted(tmp_path: Path) -> None:
    imu = readings(N, rate=100.0)
    messages = [
        (f"/imu#{k // 300}", k * STEP, cdr(imu[k]) if k < 300 else {"acc": imu[k].acc})
        for k in range(N)
    ]
    conserved(readers.read(logged(tmp_path / "log.mcap", messages)), N, 300)


def test_messages_out_of_order_are_put_in_that_of_their_times(tmp_path: Path) -> None:
    imu = readings(N, rate=100.0)
    order = np.random.default_rng(3).permutation(N).tolist()
    messages = [("/imu", k * STEP, cdr(imu[k])) for k in order]
    found = readers.read(logged(tmp_path / "log.mcap", messages))
    assert found.channels["imu0/acceleration"].values.tolist() == [list(r.acc) for r in imu]
    assert found.gaps == ()
    assert any("out of order" in note for note in found.notes)


def test_protobuf_messages_that_lack_the_vector_are_no_zeros(tmp_path: Path) -> None:
    pytest.importorskip("google.protobuf")
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    file = descriptor_pb2.FileDescriptorProto(name="own.proto", package="own", syntax="proto3")
    vector, log = (file.message_type.add(name=name) for name in ("Vector", "Log"))
    for k, axis in enumerate("xyz", start=1):
        vector.field.add(name=axis, number=k, type=1, label=1)
    log.field.add(name="acc", number=1, type=11, label=1, type_name=".own.Vector")
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName("own.Log"))
    schema = descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()
    path = tmp_path / "log.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        topic = writer.register_channel(
            "/imu", "protobuf", writer.register_schema("own.Log", "protobuf", schema)
        )
        for k, (x, y, z) in enumerate(force().tolist()):
            content = kind() if k % 4 == 0 else kind(acc={"x": x, "y": y, "z": z})
            writer.add_message(topic, k * STEP, content.SerializeToString(), k * STEP)
        writer.finish()
    found = readers.read(path, MS2)
    conserved(found, N, N - N // 4)
    assert found.channels["imu0/acceleration"].values.any(axis=1).all()
