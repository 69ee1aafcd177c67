"""Channels as ROS 2 messages: whole arrays of MCAP message records, in chunks in time order."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UsageError
from imucalib.readers.messages.definition import IMU_ROS2, TEMPERATURE_ROS2
from imucalib.readers.messages.fields import (
    META_ACC_UNIT,
    META_DATED,
    META_GYRO_UNIT,
    META_ORIGIN,
    META_QUANTITIES,
    META_TRIAD,
)
from imucalib.readers.messages.records import MESSAGE
from imucalib.recording.recording import Channel, Recording

_CHUNK_BYTES = 1 << 20
SHORT_NAMES = {"acceleration": "acc", "angular_rate": "gyro", "temperature": "temperature"}
_WIDTHS = {"acceleration": 3, "angular_rate": 3, "temperature": 1}
_UNITS = {"acceleration": "m/s2", "angular_rate": "rad/s", "temperature": "degC"}
SCHEMAS = {
    1: ("sensor_msgs/msg/Imu", IMU_ROS2),
    2: ("imucal_msgs/msg/RawImu", IMU_ROS2),  # counts are no m/s2: another type says so
    3: ("sensor_msgs/msg/Temperature", TEMPERATURE_ROS2),
}


@dataclass(frozen=True)
class Output:
    """One topic to be written: its message records but for the values."""

    number: int
    schema: int
    topic: str
    metadata: dict[str, str]
    ns: NDArray[np.int64]
    log: NDArray[np.uint64]
    values: tuple[tuple[str, Array], ...]
    dtype: np.dtype[np.void]
    frame: bytes

    def records(self, rows: slice) -> NDArray[np.void]:
        """The message records of some samples."""
        ns, log = self.ns[rows], self.log[rows]
        out = np.zeros(ns.size, dtype=self.dtype)
        out["opcode"], out["length"] = MESSAGE, self.dtype.itemsize - 9
        out["channel"], out["log"], out["publish"] = self.number, log, log
        out["sequence"] = np.arange(rows.start, rows.start + ns.size, dtype=np.uint32)
        out["cdr"], out["sec"], out["nanosec"] = 0x0100, ns // 10**9, ns % 10**9
        out["frame_length"], out["frame"] = len(self.frame), np.void(self.frame)
        for name, values in self.values:
            out[name] = values[rows]
        if self.schema != 3:
            out["no_orientation"] = -1.0  # what the message defines for "not estimated"
        return out


def outputs_of(
    recording: Recording, names: dict[str, str], first: int, origin: int
) -> list[Output]:
    """One output a topic; raises UsageError for a channel that no ROS message can hold.

    names : channel -> topic; first : lowest free channel number; origin : ns added to log times
    """
    groups: dict[tuple[str, str], list[tuple[str, Channel]]] = {}
    for name, channel in recording.channels.items():
        if _WIDTHS.get(channel.quantity) != channel.values.shape[1]:
            raise UsageError(
                f"channel {name} ({channel.quantity}, {channel.values.shape[1]} columns) has no"
                " ROS message",
                where=recording.path,
                remedy="write HDF5 (.h5) instead",
            )
        groups.setdefault((names[name], channel.triad), []).append((names[name], channel))
    split = [part for group in groups.values() for part in _by_times(group)]
    used = [topic for topic, _ in split]
    if len(set(used)) != len(used):
        raise UsageError(
            "two triads would share a topic", where=recording.path, remedy="rename the triads"
        )
    return [
        _output(recording, topic, channels, first + i, origin)
        for i, (topic, channels) in enumerate(split)
    ]


def _by_times(group: list[tuple[str, Channel]]) -> list[tuple[str, list[Channel]]]:
    """Channels of one topic; those with other times or units go to a topic beside it."""
    (topic, first), *others = group
    together = [first]
    apart: list[Channel] = []
    for _, channel in others:
        same = np.array_equal(first.t, channel.t) and _raw(first) == _raw(channel)
        (together if same else apart).append(channel)
    if not apart:
        return [(topic, together)]
    words = {"acceleration": "accel", "angular_rate": "gyro", "temperature": "temperature"}
    return [(f"{topic}/{words[c.quantity]}", [c]) for c in (*together, *apart)]


def _raw(channel: Channel) -> bool:
    return channel.unit != _UNITS[channel.quantity]


def _output(
    recording: Recording, topic: str, channels: list[Channel], number: int, origin: int
) -> Output:
    units = {SHORT_NAMES[c.quantity]: c.unit for c in channels}
    start = recording.start_ns or 0
    metadata = {
        META_TRIAD: channels[0].triad,
        META_QUANTITIES: " ".join(units),
        META_ORIGIN: str(start),
        META_DATED: "yes" if recording.start_ns is not None else "no",
        META_ACC_UNIT: units.get("acc", ""),
        META_GYRO_UNIT: units.get("gyro", ""),
    }
    temperature = channels[0].quantity == "temperature"
    schema = 3 if temperature else 2 if any(_raw(c) for c in channels) else 1
    if temperature and _raw(channels[0]):
        raise UsageError("a temperature in counts has no ROS message", where=recording.path)
    steps = np.rint(channels[0].t * 1e9).astype(np.int64)
    ns, log = start + steps, (start + origin + steps).astype(np.uint64)
    values = tuple((c.quantity, c.values[:, 0] if temperature else c.values) for c in channels)
    frame = channels[0].triad.encode() + b"\0"
    dtype = _record_type(len(frame), temperature)
    return Output(
        number=number,
        schema=schema,
        topic=topic,
        metadata=metadata,
        ns=ns,
        log=log,
        values=values,
        dtype=dtype,
        frame=frame,
    )


def _record_type(frame: int, temperature: bool) -> np.dtype[np.void]:
    """A whole message record: 31 bytes of MCAP, 4 of encapsulation, then the CDR message."""
    begin = 35 + 12 + frame
    begin += -(begin - 35) % 8
    fields: list[tuple[str, object, int]] = [
        ("opcode", "u1", 0), ("length", "<u8", 1), ("channel", "<u2", 9), ("sequence", "<u4", 11),
        ("log", "<u8", 15), ("publish", "<u8", 23), ("cdr", "<u2", 31), ("sec", "<i4", 35),
        ("nanosec", "<u4", 39), ("frame_length", "<u4", 43), ("frame", f"V{frame}", 47),
    ]  # fmt: skip
    if temperature:
        fields.append(("temperature", "<f8", begin))
        size = begin + 16
    else:
        fields += [
            ("no_orientation", "<f8", begin + 32),
            ("angular_rate", ("<f8", (3,)), begin + 104),
            ("acceleration", ("<f8", (3,)), begin + 200),
        ]
        size = begin + 296
    columns = {
        "names": [f[0] for f in fields],
        "formats": [f[1] for f in fields],
        "offsets": [f[2] for f in fields],
        "itemsize": size,
    }
    return np.dtype(columns)  # type: ignore[call-overload, no-any-return]


#: Records of a chunk, and of each message its start, channel number and log time (ns).
ChunkData = tuple[bytes, NDArray[np.int64], NDArray[np.int64], NDArray[np.uint64]]


def chunks_of(outputs: list[Output]) -> Iterator[ChunkData]:
    """Chunks of about 1 MiB, the topics interleaved in time order."""
    outputs = [output for output in outputs if output.ns.size]
    if not outputs:
        return
    total = sum(output.ns.size * output.dtype.itemsize for output in outputs)
    first = min(int(output.log.min()) for output in outputs)
    last = max(int(output.log.max()) for output in outputs)
    step = max(1, (last - first) * _CHUNK_BYTES // total)
    done = [0] * len(outputs)
    edge = first
    peaks = [np.maximum.accumulate(output.log) for output in outputs]
    while any(d < o.ns.size for d, o in zip(done, outputs, strict=True)):
        waiting = [int(p[d]) for p, d in zip(peaks, done, strict=True) if d < p.size]
        edge = max(edge + step, min(waiting) + 1)
        stops = [int(np.searchsorted(peak, np.uint64(edge))) for peak in peaks]
        yield _interleaved(outputs, [slice(a, b) for a, b in zip(done, stops, strict=True)])
        done = stops


def _interleaved(outputs: list[Output], parts: list[slice]) -> ChunkData:
    records = [output.records(part) for output, part in zip(outputs, parts, strict=True)]
    log = np.concatenate([output.log[part] for output, part in zip(outputs, parts, strict=True)])
    sizes = np.concatenate([np.full(r.size, r.dtype.itemsize) for r in records])
    channels = np.concatenate([r["channel"].astype(np.int64) for r in records])
    order = np.argsort(log, kind="stable")
    starts = np.empty(log.size, dtype=np.int64)
    starts[order] = np.cumsum(sizes[order]) - sizes[order]
    data, at = np.zeros(int(sizes.sum()), dtype=np.uint8), 0
    for part in records:
        if part.size:
            whole = np.dtype(f"V{part.dtype.itemsize}")
            view = np.ndarray((data.size - whole.itemsize + 1,), whole, data, 0, (1,))
            view[starts[at : at + part.size]] = part.view(whole)
        at += part.size
    return data.tobytes(), starts[order], channels[order], log[order]
