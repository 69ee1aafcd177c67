"""x"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

import imucalib
from imucalib.arrays import Array
from imucalib.errors import UsageError
from imucalib.readers.messages import records as mr
from imucalib.readers.messages.layout import (
    ACCEL_ROS2,
    IMU_ROS2,
    TEMPERATURE_ROS2,
    whole_definition,
)
from imucalib.readers.messages.records import MAGIC, MESSAGE, RECORD_HEADER, Topic
from imucalib.readers.messages.select import (
    META_ACC_UNIT,
    META_DATED,
    META_GYRO_UNIT,
    META_ORIGIN,
    META_QUANTITIES,
    META_TRIAD,
)
from imucalib.recording.recording import Channel, Correction, Recording
from imucalib.writers import ChannelsChange

#: Some 380 messages of one IMU: what one damaged byte costs. (1 MiB packs 12 % better on a board.)
_CHUNK_BYTES = 1 << 17
SCHEMAS = {
    1: ("sensor_msgs/msg/Imu", IMU_ROS2),
    2: ("imucal_msgs/msg/RawImu", IMU_ROS2),  # counts are no m/s2: another type says so
    3: ("sensor_msgs/msg/Temperature", TEMPERATURE_ROS2),
    4: ("geometry_msgs/msg/AccelWithCovarianceStamped", ACCEL_ROS2),
}
#: What stands first in the covariance of a quantity without an estimate (sensor_msgs/msg/Imu).
_NOT_MEASURED = -1.0
_IMU: dict[str, tuple[object, int]] = {
    "no_orientation": ("<f8", 32),
    "angular_rate": (("<f8", (3,)), 104),
    "angular_rate_covariance": (("<f8", (9,)), 128),
    "acceleration": (("<f8", (3,)), 200),
    "acceleration_covariance": (("<f8", (9,)), 224),
}
#: Of each schema the size of what follows the header, and type and place of its fields there.
_BODIES: dict[int, tuple[int, dict[str, tuple[object, int]]]] = {
    1: (296, _IMU),
    2: (296, _IMU),
    3: (16, {"temperature": ("<f8", 0)}),
    4: (
        336,
        {
            "acceleration": (("<f8", (3,)), 0),
            "angular_acceleration": (("<f8", (3,)), 24),
            "covariance": (("<f8", (6, 6)), 48),
        },
    ),
}


@dataclass(frozen=True)
class Output:
    """One topic to be written: its message records but for the values.

    channels : names of the recording's channels in it; done : messages written before these
    """

    number: int
    schema: int
    topic: str
    metadata: dict[str, str]
    ns: NDArray[np.int64]
    log: NDArray[np.uint64]
    values: tuple[tuple[str, Array], ...]
    dtype: np.dtype[np.void]
    frame: bytes
    channels: tuple[str, ...]
    done: int = 0

    def records(self, rows: slice) -> NDArray[np.void]:
        """The message records of some samples."""
        ns, log = self.ns[rows], self.log[rows]
        out = np.zeros(ns.size, dtype=self.dtype)
        out["opcode"], out["length"] = MESSAGE, self.dtype.itemsize - 9
        out["channel"], out["log"], out["publish"] = self.number, log, log
        numbers = self.done + np.arange(rows.start, rows.start + ns.size)
        out["sequence"] = numbers & 0xFFFF_FFFF
        out["cdr"], out["sec"], out["nanosec"] = 0x0100, ns // 10**9, ns % 10**9
        out["frame_length"], out["frame"] = len(self.frame), np.void(self.frame)
        for name, values in self.values:
            out[name] = values[rows]
        for name in self._absent():
            out[name].reshape(ns.size, -1)[:, 0] = _NOT_MEASURED
        return out

    def _absent(self) -> Iterator[str]:
        """The covariances of what the message has a place for and the topic has not."""
        given = {name for name, _ in self.values}
        for name in self.dtype.names or ():
            quantity = name.removesuffix(_DOUBTED)
            if name == "no_orientation" or (quantity != name and not {name, quantity} & given):
                yield name


def record_type(frame: int, schema: int) -> np.dtype[np.void]:
    """A whole message record: 31 bytes of MCAP, 4 of encapsulation, then the CDR message."""
    begin = 35 + 12 + frame
    begin += -(begin - 35) % 8
    fields: list[tuple[str, object, int]] = [
        ("opcode", "u1", 0),
        ("length", "<u8", 1),
        ("channel", "<u2", 9),
        ("sequence", "<u4", 11),
        ("log", "<u8", 15),
        ("publish", "<u8", 23),
        ("cdr", "<u2", 31),
        ("sec", "<i4", 35),
        ("nanosec", "<u4", 39),
        ("frame_length", "<u4", 43),
        ("frame", f"V{frame}", 47),
    ]
    size, body = _BODIES[schema]
    fields += [(name, kind, begin + at) for name, (kind, at) in body.items()]
    columns = {
        "names": [f[0] for f in fields],
        "formats": [f[1] for f in fields],
        "offsets": [f[2] for f in fields],
        "itemsize": begin + size,
    }
    return np.dtype(columns)  # type: ignore[call-overload, no-any-return]


#: Records of a chunk, and of each message its start, channel number and log time (ns).
ChunkData = tuple[bytes, NDArray[np.int64], NDArray[np.int64], NDArray[np.uint64]]


def chunks_of(outputs: list[Output]) -> Iterator[ChunkData]:
    """Chunks of about 128 KiB, the topics interleaved in time order."""
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


_HEADER, _CHUNK_INDEX, _SUMMARY_OFFSET = 0x01, 0x08, 0x0E
_ATTACHMENT_INDEX, _METADATA_INDEX = 0x0A, 0x0D


class McapFile:
    """An MCAP file that is being written; `close` adds the summary."""

    def __init__(self, path: Path, profile: str, library: str) -> None:
        self._file: BinaryIO = open(path, "wb")  # noqa: SIM115 - closed by close or abandon
        self._crc = 0
        self._at = 0
        self._chunks: list[bytes] = []  # their index records: of days there are many
        self._span: tuple[int, int] | None = None  # ns, first and last
        self._counts: dict[int, int] = {}
        self._definitions: dict[tuple[int, int], bytes] = {}
        self._extras: dict[int, list[bytes]] = {_ATTACHMENT_INDEX: [], _METADATA_INDEX: []}
        self._put(MAGIC)
        self._record(_HEADER, _text(profile) + _text(library))

    def schema(self, number: int, name: str, encoding: str, data: bytes) -> None:
        """Define a schema."""
        content = struct.pack("<H", number) + _text(name) + _text(encoding) + _sized(data)
        self._define(mr.SCHEMA, number, content)

    def channel(
        self, number: int, schema: int, topic: str, encoding: str, metadata: dict[str, str]
    ) -> None:
        """Define a channel of a schema (0 for none)."""
        pairs = b"".join(_text(k) + _text(v) for k, v in metadata.items())
        head = struct.pack("<HH", number, schema)
        content = head + _text(topic) + _text(encoding) + _sized(pairs)
        self._define(mr.CHANNEL, number, content)

    def chunk(
        self,
        data: bytes,
        starts: NDArray[np.int64],
        channels: NDArray[np.int64],
        log_times: NDArray[np.uint64],
    ) -> None:
        """Write message records as one chunk. starts, channels, log_times (ns) : (n,) each."""
        from imucalib.readers import zstd

        if starts.size == 0:
            return
        packed = zstd.compress(data)
        first, last = int(log_times.min()), int(log_times.max())
        head = struct.pack("<QQQI", first, last, len(data), zlib.crc32(data))
        at = self._at
        self._record(mr.CHUNK, head + _text("zstd") + struct.pack("<Q", len(packed)) + packed)
        length, index = self._at - at, {}
        for number in np.unique(channels).tolist():
            rows = np.flatnonzero(channels == number)
            rows = rows[np.argsort(log_times[rows], kind="stable")]
            entries = np.empty((rows.size, 2), dtype="<u8")
            entries[:, 0], entries[:, 1] = log_times[rows], starts[rows]
            index[number] = self._at
            body = struct.pack("<HI", number, entries.nbytes) + entries.tobytes()
            self._record(mr.MESSAGE_INDEX, body)
            self._counts[number] = self._counts.get(number, 0) + rows.size
        head = struct.pack("<QQQQ", first, last, at, length)
        where = b"".join(struct.pack("<HQ", *pair) for pair in index.items())
        sizes = struct.pack("<QQ", len(packed), len(data))
        tail = struct.pack("<Q", self._at - at - length)
        self._chunks.append(head + _sized(where) + tail + _text("zstd") + sizes)
        low, high = self._span or (first, last)
        self._span = min(low, first), max(high, last)

    def attachment(self, content: bytes) -> None:
        """Write an attachment record with its content as another file has it."""
        at = self._at
        self._record(mr.ATTACHMENT, content)
        name, end = mr.text_at(content, 16)
        media, end = mr.text_at(content, end)
        head = struct.pack("<QQ", at, self._at - at) + content[:16] + content[end : end + 8]
        self._extras[_ATTACHMENT_INDEX].append(head + _text(name) + _text(media))

    def metadata(self, content: bytes) -> None:
        """Write a metadata record with its content as another file has it."""
        at = self._at
        self._record(mr.METADATA, content)
        head = struct.pack("<QQ", at, self._at - at)
        self._extras[_METADATA_INDEX].append(head + _text(mr.text_at(content, 0)[0]))

    def marks(self, corrections: tuple[Correction, ...]) -> None:
        """Write which calibrations were applied, as a metadata record; nothing when none was."""
        if corrections:
            texts = [_text(str(k)) + _text(c.to_text()) for k, c in enumerate(corrections)]
            self.metadata(_text(mr.CORRECTIONS) + _sized(b"".join(texts)))

    def close(self) -> None:
        """Write the summary and the footer, and make sure that they are on the disk."""
        import os

        self._record(mr.DATA_END, struct.pack("<I", self._crc))
        start = self._at
        self._crc = 0
        groups = []
        for kind in (mr.SCHEMA, mr.CHANNEL):
            contents = [c for (k, _), c in self._definitions.items() if k == kind]
            groups.append((kind, contents))
        groups.append((mr.STATISTICS, [self._statistics()]))
        groups.append((_CHUNK_INDEX, self._chunks))
        groups += self._extras.items()
        offsets = []
        for kind, contents in groups:
            begin = self._at
            for content in contents:
                self._record(kind, content)
            if contents:
                offsets.append(struct.pack("<BQQ", kind, begin, self._at - begin))
        offset_start = self._at
        for content in offsets:
            self._record(_SUMMARY_OFFSET, content)
        head = RECORD_HEADER.pack(mr.FOOTER, 20) + struct.pack("<QQ", start, offset_start)
        self._put(head)
        self._put(struct.pack("<I", self._crc) + MAGIC)
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()

    def abandon(self) -> None:
        """Close the file without finishing it."""
        self._file.close()

    def _statistics(self) -> bytes:
        kinds = [kind for kind, _ in self._definitions]
        first, last = self._span or (0, 0)
        counts = b"".join(struct.pack("<HQ", *pair) for pair in self._counts.items())
        numbers = (sum(self._counts.values()), kinds.count(mr.SCHEMA), kinds.count(mr.CHANNEL))
        extras = [len(self._extras[kind]) for kind in (_ATTACHMENT_INDEX, _METADATA_INDEX)]
        head = struct.pack("<QHIIIIQQ", *numbers, *extras, len(self._chunks), first, last)
        return head + _sized(counts)

    def _define(self, kind: int, number: int, content: bytes) -> None:
        if self._definitions.get((kind, number)) != content:
            self._definitions[kind, number] = content
            self._record(kind, content)

    def _record(self, opcode: int, content: bytes) -> None:
        self._put(RECORD_HEADER.pack(opcode, len(content)))
        self._put(content)

    def _put(self, data: bytes) -> None:
        self._file.write(data)
        self._crc = zlib.crc32(data, self._crc)
        self._at += len(data)


def _text(text: str) -> bytes:
    return _sized(text.encode())


def _sized(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data


SHORT_NAMES = {"acceleration": "acc", "angular_rate": "gyro", "temperature": "temperature"}
_SPUN, _DOUBTED = "angular_acceleration", "_covariance"
_WIDTHS = {"acceleration": 3, "angular_rate": 3, "temperature": 1, _SPUN: 3}
_WIDTHS |= {f"{name}{_DOUBTED}": 9 for name in ("acceleration", "angular_rate", _SPUN)}
_UNITS = {
    "acceleration": "m/s2",
    "angular_rate": "rad/s",
    "temperature": "degC",
    _SPUN: "rad/s2",
    "acceleration_covariance": "m2/s4",
    "angular_rate_covariance": "rad2/s2",
    "angular_acceleration_covariance": "rad2/s4",
}
Part = tuple[str, tuple[str, ...]]  #: a topic, and the names of the channels in it


def outputs_of(
    recording: Recording, names: dict[str, str], first: int, origin: int
) -> list[Output]:
    """One output a topic; raises UsageError for a channel that no ROS message can hold.

    names : channel -> topic; first : lowest free channel number; origin : ns added to log times
    """
    _demand_messages(recording)
    groups: dict[tuple[str, str], list[str]] = {}
    for name, channel in recording.channels.items():
        groups.setdefault((names[name], channel.triad), []).append(name)
    split = [
        part for (topic, _), group in groups.items() for part in _by_times(topic, group, recording)
    ]
    used = [topic for topic, _ in split]
    if len(set(used)) != len(used):
        raise UsageError(
            "two triads would share a topic", where=recording.path, remedy="rename the triads"
        )
    return [
        _output(recording, topic, channels, first + i, origin)
        for i, (topic, channels) in enumerate(split)
    ]


def following(outputs: list[Output], recording: Recording) -> list[Output]:
    """The outputs of the block after, in the topics of the one before.

    Raises ChannelsChange for a channel that is in none, or whose times leave those that share its
    topic.
    """
    _demand_messages(recording)
    found = []
    for before in outputs:
        present = tuple(n for n in before.channels if n in recording.channels)
        done = before.done + before.ns.size
        if not present:
            none = slice(0)
            values = tuple((q, v[none]) for q, v in before.values)
            empty = replace(before, ns=before.ns[none], log=before.log[none], values=values)
            found.append(replace(empty, done=done))
            continue
        times = [recording.channels[n].t for n in present]
        if present != before.channels or any(not np.array_equal(times[0], t) for t in times[1:]):
            raise _changed(recording, before.channels)
        now = _output(recording, before.topic, present, before.number, 0)
        if (now.schema, now.metadata) != (before.schema, before.metadata):
            raise _changed(recording, before.channels)
        found.append(replace(now, done=done))
    unknown = set(recording.channels) - {n for output in outputs for n in output.channels}
    if unknown:
        raise _changed(recording, tuple(sorted(unknown)))
    return found


def _changed(recording: Recording, channels: tuple[str, ...]) -> ChannelsChange:
    return ChannelsChange(
        f"channels change within the recording: {', '.join(channels)}",
        where=recording.path,
        remedy="write HDF5 (.h5) instead",
    )


def _demand_messages(recording: Recording) -> None:
    """Raise UsageError for a channel that no message can hold."""
    for name, channel in recording.channels.items():
        if _WIDTHS.get(channel.quantity) != channel.values.shape[1]:
            raise UsageError(
                f"channel {name} ({channel.quantity}, {channel.values.shape[1]} columns) has no"
                " ROS message",
                where=recording.path,
                remedy="write HDF5 (.h5) instead",
            )


def _by_times(topic: str, group: list[str], recording: Recording) -> list[Part]:
    """Channels of one topic; those with other times or units go to a topic beside it."""
    first = recording.channels[group[0]]
    together, apart = [group[0]], list[str]()
    for name in group[1:]:
        channel = recording.channels[name]
        same = np.array_equal(first.t, channel.t) and _raw(first) == _raw(channel)
        (together if same else apart).append(name)
    if not apart:
        return [(topic, tuple(together))]
    words = {"acceleration": "accel", "angular_rate": "gyro", "temperature": "temperature"}
    words |= {f"{name}{_DOUBTED}": f"{word}{_DOUBTED}" for name, word in words.items()}
    quantities = {n: recording.channels[n].quantity for n in (*together, *apart)}
    return [(f"{topic}/{words[quantities[n]]}", (n,)) for n in (*together, *apart)]


def _raw(channel: Channel) -> bool:
    return channel.unit != _UNITS[channel.quantity]


def _output(
    recording: Recording, topic: str, names: tuple[str, ...], number: int, origin: int
) -> Output:
    channels = [recording.channels[n] for n in names]
    units = {SHORT_NAMES[c.quantity]: c.unit for c in channels if c.quantity in SHORT_NAMES}
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
    spun = any(c.quantity.startswith(_SPUN) for c in channels)
    schema = 3 if temperature else 4 if spun else 2 if any(_raw(c) for c in channels) else 1
    if temperature and _raw(channels[0]):
        raise UsageError("a temperature in counts has no ROS message", where=recording.path)
    steps = np.rint(channels[0].t * 1e9).astype(np.int64)
    ns, log = start + steps, (start + origin + steps).astype(np.uint64)
    values = tuple((c.quantity, c.values[:, 0] if temperature else c.values) for c in channels)
    if spun:
        values = _accel(recording, channels[0].triad, channels[0].t)
    frame = channels[0].triad.encode() + b"\0"
    dtype = record_type(len(frame), schema)
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
        channels=names,
    )


def _accel(recording: Recording, triad: str, t: Array) -> tuple[tuple[str, Array], ...]:
    """The six of an acceleration message and their covariance; NaN of what the triad has not."""
    own = {
        c.quantity: c.values
        for c in recording.channels.values()
        if c.triad == triad and np.array_equal(c.t, t)
    }
    covariance = np.zeros((len(t), 6, 6))
    for k, name in enumerate(("acceleration", _SPUN)):
        inner = slice(3 * k, 3 * k + 3)
        found = own.get(f"{name}{_DOUBTED}")
        covariance[:, inner, inner] = np.nan if found is None else found.reshape(-1, 3, 3)
    none = np.full((len(t), 3), np.nan)
    return (
        ("acceleration", own.get("acceleration", none)),
        (_SPUN, own.get(_SPUN, none)),
        ("covariance", covariance),
    )


LIBRARY = f"imucal {imucalib.__version__}"


class McapWriter:
    """The MCAP writer."""

    name = "mcap"
    suffixes = (".mcap",)

    def write(self, recording: Recording, path: Path) -> None:
        """Write all channels; UsageError for one that a sensor_msgs message cannot hold."""
        self.write_blocks([recording], path)

    def write_blocks(self, blocks: Iterable[Recording], path: Path) -> None:
        """Write block after block; memory holds one. Errors as in `write`, and ChannelsChange where
        the topics of the first block do not fit a later one."""
        file = McapFile(path, "ros2", LIBRARY)
        outputs: list[Output] = []
        try:
            for recording in blocks:
                if outputs:
                    outputs = following(outputs, recording)
                elif recording.channels:
                    outputs, base = outputs_beside(recording, {}, {}, topic_names(recording), 0)
                    file.marks(recording.corrections)
                    define(file, outputs, {}, base)
                for chunk in chunks_of(outputs):
                    file.chunk(*chunk)
            file.close()
        finally:
            file.abandon()


def outputs_beside(
    recording: Recording,
    topics: dict[int, Topic],
    kept: dict[int, Topic],
    names: dict[str, str],
    origin: int,
) -> tuple[list[Output], int]:
    """The topics that are written anew, and the highest schema number of the file they join.

    topics : of that file, by channel number; kept : those of them that stay; names : channel ->
    topic; origin : ns added to log times
    """
    clashes = {t.name for t in kept.values()} & set(names.values())
    if clashes:
        raise UsageError(f"the source has topics of the same name: {', '.join(sorted(clashes))}")
    first = max([0, *topics]) + 1
    outputs = outputs_of(recording, names, first, origin)
    base = max([0, *(t.schema.id for t in topics.values() if t.schema)])
    if first + len(outputs) > 65535 or base + len(SCHEMAS) > 65535:
        raise UsageError("the source has no free channel numbers left", where=recording.path)
    return outputs, base


def define(file: McapFile, outputs: list[Output], kept: dict[int, Topic], base: int) -> None:
    for topic in kept.values():
        if topic.schema:
            known = topic.schema
            data = whole_definition(known.data, known.encoding)
            file.schema(known.id, known.name, known.encoding, data)
    for number in sorted({output.schema for output in outputs}):
        name, text = SCHEMAS[number]
        file.schema(base + number, name, "ros2msg", text.encode())
    for number, topic in kept.items():
        schema = topic.schema.id if topic.schema else 0
        file.channel(number, schema, topic.name, topic.encoding, dict(topic.metadata))
    for output in outputs:
        file.channel(output.number, base + output.schema, output.topic, "cdr", output.metadata)


def topic_names(recording: Recording) -> dict[str, str]:
    """The topic of each channel: "/<triad>/imu", "/<triad>/temperature", "/<triad>/accel"."""
    names = {}
    for name, channel in recording.channels.items():
        ending = "temperature" if channel.quantity == "temperature" else "imu"
        ending = "accel" if channel.quantity.startswith("angular_acceleration") else ending
        names[name] = f"/{channel.triad}/{ending}"
    return names


WRITER = McapWriter()
