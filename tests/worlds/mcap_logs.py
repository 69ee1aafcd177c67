"""MCAP logs for the tests: IMU messages in every encoding, packed here byte by byte."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer
from mcap_ros2._dynamic import serialize_dynamic

from imucalib.readers.mcap import McapLog

START = 1_700_000_000_123_456_789
SEPARATOR = "=" * 80
HEADER_ROS2 = f"""{SEPARATOR}
MSG: std_msgs/Header
# Standard metadata
builtin_interfaces/Time stamp
string frame_id
{SEPARATOR}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
IMU_BODY = f"""# This is a message to hold data from an IMU
std_msgs/Header header

geometry_msgs/Quaternion orientation
float64[9] orientation_covariance # Row major about x, y, z axes

geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance

geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance

{SEPARATOR}
MSG: geometry_msgs/Quaternion
float64 x 0
float64 y 0
float64 z 0
float64 w 1

{SEPARATOR}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z

"""
IMU_ROS2 = IMU_BODY + HEADER_ROS2
IMU_ROS1 = IMU_BODY.replace("std_msgs/Header header", "Header header") + (
    f"{SEPARATOR}\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
)
encode_cdr = serialize_dynamic("sensor_msgs/msg/Imu", IMU_ROS2)["sensor_msgs/msg/Imu"]


@dataclass(frozen=True)
class Reading:
    """One IMU message."""

    ns: int
    acc: tuple[float, ...]
    gyro: tuple[float, ...]
    frame: str = "imu"


def body(reading: Reading, order: str) -> bytes:
    """The 37 doubles after the header."""
    numbers = [0.0, 0.0, 0.0, 1.0, *range(9), *reading.gyro, *range(9), *reading.acc, *range(9)]
    return struct.pack(f"{order}37d", *numbers)


def cdr(reading: Reading, order: str = "<", version: int = 1) -> bytes:
    """sensor_msgs/msg/Imu in CDR version 1 or 2 (doubles align to 8 or to 4 bytes)."""
    frame = reading.frame.encode() + b"\0"
    head = struct.pack(f"{order}iII", reading.ns // 10**9, reading.ns % 10**9, len(frame))
    head += frame
    head += b"\0" * (-len(head) % (8 if version == 1 else 4))
    number = {(1, ">"): 0, (1, "<"): 1, (2, ">"): 6, (2, "<"): 7}[version, order]
    return bytes([0, number, 0, 0]) + head + body(reading, order)


def official_cdr(reading: Reading) -> bytes:
    """The same through the official encoder."""
    vector = lambda v: dict(zip("xyz", v, strict=True))  # noqa: E731
    stamp = {"sec": reading.ns // 10**9, "nanosec": reading.ns % 10**9}
    message = {
        "header": {"stamp": stamp, "frame_id": reading.frame},
        "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        "orientation_covariance": [0.0] * 9,
        "angular_velocity": vector(reading.gyro),
        "angular_velocity_covariance": [0.0] * 9,
        "linear_acceleration": vector(reading.acc),
        "linear_acceleration_covariance": [0.0] * 9,
    }
    return bytes(encode_cdr(message))


def ros1(reading: Reading) -> bytes:
    """sensor_msgs/Imu as ROS 1 stores it: no padding anywhere."""
    frame = reading.frame.encode()
    head = struct.pack("<IIII", 7, reading.ns // 10**9, reading.ns % 10**9, len(frame))
    return head + frame + body(reading, "<")


def readings(count: int, seed: int = 0, rate: float = 1000.0, frame: str = "imu") -> list[Reading]:
    """Readings of a sensor at rest, quantised."""
    rng = np.random.default_rng(seed)
    acc = np.round(rng.normal((0.0, 0.0, 9.81), 0.02, (count, 3)) / 0.0012) * 0.0012
    gyro = np.round(rng.normal(0, 0.01, (count, 3)) / 0.0005) * 0.0005
    step = round(1e9 / rate)
    return [
        Reading(START + i * step, tuple(a), tuple(g), frame)
        for i, (a, g) in enumerate(zip(acc.tolist(), gyro.tolist(), strict=True))
    ]


def write_log(
    path: Path,
    topics: dict[str, list[tuple[int, bytes]]],
    *,
    schema: tuple[str, str, bytes] = ("sensor_msgs/msg/Imu", "ros2msg", IMU_ROS2.encode()),
    encoding: str = "cdr",
    compression: CompressionType = CompressionType.ZSTD,
    chunk_size: int = 32 * 1024,
    in_order: bool = True,
    **options: object,
) -> Path:
    """A log with the official writer: topic -> (log time, ns; payload), by it or as given."""
    with path.open("wb") as file:
        writer = Writer(file, compression=compression, chunk_size=chunk_size, **options)
        writer.start("ros2")
        number = writer.register_schema(*schema)
        channels = {topic: writer.register_channel(topic, encoding, number) for topic in topics}
        messages = [
            (log, i, topic, payload)
            for topic, pairs in topics.items()
            for i, (log, payload) in enumerate(pairs)
        ]
        for log, i, topic, payload in sorted(messages, key=lambda m: m[0] if in_order else 0):
            writer.add_message(channels[topic], log, payload, log, i)
        writer.finish()
    return path


def packed(
    rows: list[Reading], pack: Callable[[Reading], bytes], delay: int = 1000
) -> list[tuple[int, bytes]]:
    """Payloads, logged a little after they were stamped."""
    return [(row.ns + delay, pack(row)) for row in rows]


def imu_log(path: Path, count: int = 1000, **options: object) -> Path:
    """A plain one-IMU log."""
    return write_log(path, {"/imu/data": packed(readings(count), cdr)}, **options)


def messages_of(log: McapLog) -> list[tuple[int, int, int, int, bytes]]:
    """Channel, sequence, log time, publish time and payload of every message, in file order."""
    found: list[tuple[int, int, int, int, bytes]] = []
    for block in log.blocks():
        names = ("channel", "sequence", "log_time", "publish_time")
        columns = [block.header(name).tolist() for name in names]
        found += list(zip(*columns, block.payloads(), strict=True))
    return found


def values(rows: list[Reading], name: str) -> np.ndarray:
    """(n, 3) of "acc" or "gyro"."""
    return np.array([getattr(row, name) for row in rows]).reshape(-1, 3)


def same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    """Equal to the last bit, NaN included."""
    return a.shape == b.shape and a.dtype == b.dtype and a.tobytes() == b.tobytes()
