"""Recordings as MCAP: sensor_msgs/Imu messages in CDR, one topic a triad.

A triad whose numbers are counts gets a message of the same layout under another name, and times
that no message can share get topics of their own. What a ROS message cannot say (the triad, units,
the date of t = 0) is in the channel's metadata. Records are those of the package mcap, but for
messages and their indexes, which are made as whole arrays.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

import numpy as np
from mcap import records as mr
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from numpy.typing import NDArray

import imucalib
from imucalib.arrays import Array, Index
from imucalib.errors import UsageError
from imucalib.readers.fields.choice import OPTIONS
from imucalib.readers.mcap import CORRECTIONS, MAGIC, RECORD_HEADER
from imucalib.readers.messages.layout import (
    ACCEL_ROS2,
    IMU_ROS2,
    REST_ROS2,
    TEMPERATURE_ROS2,
)
from imucalib.readers.messages.records import HEAD_FIELDS, MESSAGE_HEAD, record_type
from imucalib.readers.messages.select import (
    META_DATED,
    META_ORIGIN,
    META_QUANTITIES,
    META_TRIAD,
    META_UNITS,
)
from imucalib.recording.recording import (
    REST,
    REST_COLUMNS,
    AppliedCalibration,
    Channel,
    Recording,
)
from imucalib.writers import ChannelsChange

#: Some 380 messages of one IMU: what one damaged byte costs. (1 MiB packs 12 % better on a board.)
_CHUNK_BYTES = 1 << 17
#: What comes first in the covariance of a quantity without an estimate (sensor_msgs/msg/Imu).
_NOT_MEASURED = -1.0
_SPUN, _DOUBTED = "angular_acceleration", "_covariance"
#: Of each quantity the unit that messages have, how many numbers, and its word in topics.
_QUANTITIES = {
    "acceleration": ("m/s2", 3, "accel"),
    "angular_rate": ("rad/s", 3, "gyro"),
    "temperature": ("degC", 1, "temperature"),
    _SPUN: ("rad/s2", 3, _SPUN),
    f"acceleration{_DOUBTED}": ("m2/s4", 9, f"accel{_DOUBTED}"),
    f"angular_rate{_DOUBTED}": ("rad2/s2", 9, f"gyro{_DOUBTED}"),
    f"{_SPUN}{_DOUBTED}": ("rad2/s4", 9, f"{_SPUN}{_DOUBTED}"),
    REST: ("", len(REST_COLUMNS), REST),
}
_IMU: dict[str, tuple[int, tuple[int, ...]]] = {
    "no_orientation": (32, ()),
    "angular_rate": (104, (3,)),
    f"angular_rate{_DOUBTED}": (128, (9,)),
    "acceleration": (200, (3,)),
    f"acceleration{_DOUBTED}": (224, (9,)),
}


class _Message(NamedTuple):
    """A type of messages: its definition; size of what follows the header, and the place and shape
    of the doubles there."""

    name: str
    definition: str
    size: int
    fields: dict[str, tuple[int, tuple[int, ...]]]


MESSAGES = (
    _Message("sensor_msgs/msg/Imu", IMU_ROS2, 296, _IMU),
    # Counts are no m/s2: another type says so.
    _Message("imucal_msgs/msg/RawImu", IMU_ROS2, 296, _IMU),
    _Message("sensor_msgs/msg/Temperature", TEMPERATURE_ROS2, 16, {"temperature": (0, (1,))}),
    _Message(
        "geometry_msgs/msg/AccelWithCovarianceStamped",
        ACCEL_ROS2,
        336,
        {"acceleration": (0, (3,)), _SPUN: (24, (3,)), "covariance": (48, (6, 6))},
    ),
    _Message("imucal_msgs/msg/Rest", REST_ROS2, 72, {REST: (0, (len(REST_COLUMNS),))}),
)
_PLAIN, _RAW, _WARM, _ACCEL, _REST = range(len(MESSAGES))


class McapFile:
    """An MCAP file that is being written; leaving the context without an error finishes it."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb")
        self._at = self._crc = 0
        self._definitions: dict[Opcode, list[mr.Schema | mr.Channel]] = {
            Opcode.SCHEMA: [],
            Opcode.CHANNEL: [],
        }
        #: As bytes: of days there are many.
        self._indexes: dict[Opcode, list[bytes]] = {
            Opcode.CHUNK_INDEX: [],
            Opcode.ATTACHMENT_INDEX: [],
            Opcode.METADATA_INDEX: [],
        }
        self._counts: dict[int, int] = {}
        self._spans: list[int] = []  # ns, of the first and last message
        self._put(MAGIC)
        self._put(_bytes(mr.Header("ros2", f"imucal {imucalib.__version__}")))

    def __enter__(self) -> McapFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: object, trace: TracebackType | None
    ) -> None:
        with self._file:
            if kind is None:
                self._finish()
                self._file.flush()
                os.fsync(self._file.fileno())

    def define(self, record: mr.Schema | mr.Channel) -> None:
        """Write the definition of a schema or channel."""
        kind = Opcode.SCHEMA if isinstance(record, mr.Schema) else Opcode.CHANNEL
        self._definitions[kind].append(record)
        self._put(_bytes(record))

    def chunk(
        self, records: Sequence[bytes], channels: NDArray[np.int64], log_times: NDArray[np.int64]
    ) -> None:
        """Write message records as one chunk. channels, log_times (ns) : (n,) each."""
        import zstandard

        if not records:
            return
        data = b"".join(records)
        ends = np.cumsum([len(record) for record in records])
        starts = np.concatenate([[0], ends[:-1]])
        packed = zstandard.compress(data)
        first, last = int(log_times.min()), int(log_times.max())
        self._spans = [min([first, *self._spans]), max([last, *self._spans])]
        chunk = mr.Chunk(
            compression="zstd",
            data=packed,
            message_start_time=first,
            message_end_time=last,
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        at = self._put(_bytes(chunk))
        index = mr.ChunkIndex(
            chunk_length=self._at - at,
            chunk_start_offset=at,
            compression="zstd",
            compressed_size=len(packed),
            message_start_time=first,
            message_end_time=last,
            message_index_length=0,
            message_index_offsets={},
            uncompressed_size=len(data),
        )
        after = self._at
        for number in np.unique(channels).tolist():
            rows = np.flatnonzero(channels == number)
            rows = rows[np.argsort(log_times[rows], kind="stable")]
            entries = np.stack([log_times[rows], starts[rows]], axis=1).astype("<u8")
            body = struct.pack("<HI", number, entries.nbytes) + entries.tobytes()
            head = RECORD_HEADER.pack(Opcode.MESSAGE_INDEX, len(body))
            index.message_index_offsets[number] = self._put(head + body)
            self._counts[number] = self._counts.get(number, 0) + rows.size
        index.message_index_length = self._at - after
        self._indexes[Opcode.CHUNK_INDEX].append(_bytes(index))

    def attachment(self, record: mr.Attachment) -> None:
        """Write an attachment."""
        at = self._put(_bytes(record))
        index = mr.AttachmentIndex(
            offset=at,
            length=self._at - at,
            log_time=record.log_time,
            create_time=record.create_time,
            data_size=len(record.data),
            name=record.name,
            media_type=record.media_type,
        )
        self._indexes[Opcode.ATTACHMENT_INDEX].append(_bytes(index))

    def metadata(self, record: mr.Metadata) -> None:
        """Write a metadata record."""
        at = self._put(_bytes(record))
        index = mr.MetadataIndex(offset=at, length=self._at - at, name=record.name)
        self._indexes[Opcode.METADATA_INDEX].append(_bytes(index))

    def marks(self, corrections: tuple[AppliedCalibration, ...]) -> None:
        """Write which calibrations were applied, as a metadata record; nothing when none was."""
        if corrections:
            texts = {str(k): c.to_text() for k, c in enumerate(corrections)}
            self.metadata(mr.Metadata(CORRECTIONS, texts))

    def _finish(self) -> None:
        """Write the summary and the footer."""
        self._put(_bytes(mr.DataEnd(self._crc)))
        start, self._crc = self._at, 0
        groups = {kind: list(map(_bytes, known)) for kind, known in self._definitions.items()}
        groups |= {Opcode.STATISTICS: [_bytes(self._statistics())], **self._indexes}
        offsets = []
        for kind, records in groups.items():
            begin = self._at
            for record in records:
                self._put(record)
            if records:
                offsets.append(mr.SummaryOffset(kind, begin, self._at - begin))
        offset_start = self._at
        for offset in offsets:
            self._put(_bytes(offset))
        self._put(_bytes(mr.Footer(start, offset_start, 0))[:-4])
        self._put(struct.pack("<I", self._crc) + MAGIC)

    def _statistics(self) -> mr.Statistics:
        first, last = self._spans or (0, 0)
        return mr.Statistics(
            attachment_count=len(self._indexes[Opcode.ATTACHMENT_INDEX]),
            channel_count=len(self._definitions[Opcode.CHANNEL]),
            channel_message_counts=self._counts,
            chunk_count=len(self._indexes[Opcode.CHUNK_INDEX]),
            message_count=sum(self._counts.values()),
            message_start_time=first,
            message_end_time=last,
            metadata_count=len(self._indexes[Opcode.METADATA_INDEX]),
            schema_count=len(self._definitions[Opcode.SCHEMA]),
        )

    def _put(self, data: bytes) -> int:
        """Write on; returns where."""
        at = self._at
        self._file.write(data)
        self._crc = zlib.crc32(data, self._crc)
        self._at += len(data)
        return at


def _bytes(record: mr.McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


@dataclass
class Output:
    """One topic to be written, and of the block at hand its times and values.

    message : place in `MESSAGES`; channels : names of the recording's channels in it
    done : messages that were written; ns, log : (n,) stamps and log times
    """

    number: int
    topic: str
    message: int
    metadata: dict[str, str]
    channels: tuple[str, ...]
    done: int = 0
    ns: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    log: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    values: dict[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.frame = self.metadata[META_TRIAD].encode() + b"\0"
        self.dtype = _message_type(len(self.frame), MESSAGES[self.message])

    def take(self, recording: Recording, origin: int) -> None:
        """Go on to a block, of which it may have nothing; origin : ns added to log times.

        Raises ChannelsChange where what belongs to the topic no longer fits one message.
        """
        self.done += self.ns.size
        found = {n: recording.channels[n] for n in self.channels if n in recording.channels}
        if not found:
            self.ns, self.log = self.ns[:0], self.log[:0]
            return
        first = next(iter(found.values()))
        same = tuple(found) == self.channels and all(
            np.array_equal(first.t, channel.t) for channel in found.values()
        )
        if not same or _kind(recording, self.channels) != (self.message, self.metadata):
            raise ChannelsChange(", ".join(self.channels), recording.path)
        steps = np.rint(first.t * 1e9).astype(np.int64)
        start = recording.start_ns or 0
        self.ns, self.log = start + steps, start + origin + steps
        self.values = {channel.quantity: channel.values for channel in found.values()}
        if self.message == _ACCEL:
            self.values = _accel(recording, first)

    def records(self, rows: Index) -> list[bytes]:
        """The message records of some samples."""
        ns, log = self.ns[rows], self.log[rows]
        out = np.zeros(ns.size, dtype=self.dtype)
        out["opcode"], out["length"] = Opcode.MESSAGE, self.dtype.itemsize - 9
        out["channel"], out["log_time"], out["publish_time"] = self.number, log, log
        out["sequence"] = (self.done + rows) & 0xFFFF_FFFF
        out["cdr"], out["sec"], out["nanosec"] = 0x0100, ns // 10**9, ns % 10**9
        out["frame_length"], out["frame"] = len(self.frame), np.void(self.frame)
        for name, values in self.values.items():
            out[name] = values[rows]
        for name in MESSAGES[self.message].fields:
            # Covariances of what the message has a place for and the topic has not.
            quantity = name.removesuffix(_DOUBTED)
            absent = quantity != name and not {name, quantity} & set(self.values)
            if absent or name == "no_orientation":
                out[name].reshape(ns.size, -1)[:, 0] = _NOT_MEASURED
        return list(out.view(f"V{self.dtype.itemsize}").tolist())


def _message_type(frame: int, message: _Message) -> np.dtype[np.void]:
    """A whole message record: 31 bytes of MCAP, 4 of encapsulation, then the CDR message."""
    head = MESSAGE_HEAD + 4
    begin = head + 12 + frame
    begin += -(begin - head) % 8
    fields = [
        *HEAD_FIELDS,
        ("cdr", "<u2", MESSAGE_HEAD),
        ("sec", "<i4", head),
        ("nanosec", "<u4", head + 4),
        ("frame_length", "<u4", head + 8),
        ("frame", f"V{frame}", head + 12),
        *((name, ("<f8", s), begin + at) for name, (at, s) in message.fields.items()),
    ]
    return record_type(fields, begin + message.size)


def _accel(recording: Recording, first: Channel) -> dict[str, Array]:
    """The six of an acceleration message and their covariance; NaN of what the triad has not."""
    n = first.t.size
    own = {
        c.quantity: c.values
        for c in recording.channels.values()
        if c.triad == first.triad and np.array_equal(c.t, first.t)
    }
    covariance = np.zeros((n, 6, 6))
    for k, name in enumerate(("acceleration", _SPUN)):
        inner = slice(3 * k, 3 * k + 3)
        found = own.get(f"{name}{_DOUBTED}")
        covariance[:, inner, inner] = np.nan if found is None else found.reshape(-1, 3, 3)
    vectors = {name: own.get(name, np.full((n, 3), np.nan)) for name in ("acceleration", _SPUN)}
    return {**vectors, "covariance": covariance}


def _kind(recording: Recording, names: tuple[str, ...]) -> tuple[int, dict[str, str]]:
    """Which message holds these channels, and the metadata of its topic."""
    channels = [recording.channels[name] for name in names]
    units = {c.quantity: c.unit for c in channels if c.quantity in OPTIONS}
    metadata = {
        META_TRIAD: channels[0].triad,
        META_QUANTITIES: " ".join(OPTIONS[q] for q in units),
        META_ORIGIN: str(recording.start_ns or 0),
        META_DATED: "yes" if recording.start_ns is not None else "no",
        **{name: units.get(quantity, "") for quantity, name in META_UNITS.items()},
    }
    raw = any(_is_raw(c) for c in channels)
    if channels[0].quantity == "temperature":
        if raw:
            raise UsageError("a temperature in counts has no ROS message", where=recording.path)
        return _WARM, metadata
    if channels[0].quantity == REST:
        return _REST, metadata
    spun = any(c.quantity.startswith(_SPUN) for c in channels)
    return _ACCEL if spun else _RAW if raw else _PLAIN, metadata


def _is_raw(channel: Channel) -> bool:
    return channel.unit != _QUANTITIES[channel.quantity][0]


def outputs_of(recording: Recording, names: dict[str, str], first: int) -> list[Output]:
    """One output a topic; raises UsageError for a channel that no ROS message can hold.

    names : channel -> topic; first : lowest free channel number
    """
    _demand_messages(recording)
    groups: dict[tuple[str, str], list[str]] = {}
    for name, channel in recording.channels.items():
        groups.setdefault((names[name], channel.triad), []).append(name)
    found = [
        (topic, channels)
        for (base, _), group in groups.items()
        for topic, channels in _by_times(base, group, recording).items()
    ]
    if len({topic for topic, _ in found}) != len(found):
        raise UsageError(
            "two triads would share a topic", where=recording.path, remedy="rename the triads"
        )
    return [
        Output(first + i, topic, *_kind(recording, channels), channels)
        for i, (topic, channels) in enumerate(found)
    ]


def _by_times(topic: str, group: list[str], recording: Recording) -> dict[str, tuple[str, ...]]:
    """The channels of a topic; where times or units differ, a topic below it for each."""
    channels = [recording.channels[name] for name in group]
    first = channels[0]
    if all(np.array_equal(first.t, c.t) and _is_raw(first) == _is_raw(c) for c in channels):
        return {topic: tuple(group)}
    words = [_QUANTITIES[channel.quantity][2] for channel in channels]
    return {f"{topic}/{word}": (name,) for word, name in zip(words, group, strict=True)}


def _demand_messages(recording: Recording) -> None:
    """Raise UsageError for a channel that no message can hold."""
    for name, channel in recording.channels.items():
        width = channel.values.shape[1]
        if channel.quantity not in _QUANTITIES or _QUANTITIES[channel.quantity][1] != width:
            raise UsageError(
                f"channel {name} ({channel.quantity}, {width} columns) has no ROS message",
                where=recording.path,
                remedy="write HDF5 (.h5) instead",
            )


def put_block(file: McapFile, outputs: list[Output], recording: Recording, origin: int = 0) -> None:
    """Write a block of a recording in chunks of about 128 KiB, the topics in order of time.

    Raises UsageError for a channel that no message can hold, and ChannelsChange for one that is in
    none of the topics.
    """
    _demand_messages(recording)
    unknown = set(recording.channels) - {name for output in outputs for name in output.channels}
    if unknown:
        raise ChannelsChange(", ".join(sorted(unknown)), recording.path)
    for output in outputs:
        output.take(recording, origin)
    counts = [output.ns.size for output in outputs]
    if not any(counts):
        return
    log = np.concatenate([output.log for output in outputs])
    owner, row = (
        np.repeat(np.arange(len(counts)), counts),
        np.concatenate(list(map(np.arange, counts))),
    )
    order = np.argsort(log, kind="stable")
    sizes = np.array([output.dtype.itemsize for output in outputs])
    number = np.array([output.number for output in outputs])
    chunk = np.cumsum(sizes[owner[order]]) // _CHUNK_BYTES
    for part in np.split(order, np.flatnonzero(np.diff(chunk)) + 1):
        records = np.empty(part.size, dtype=object)
        for k in np.unique(owner[part]).tolist():
            mine = owner[part] == k
            records[mine] = outputs[k].records(row[part[mine]])
        file.chunk(records.tolist(), number[owner[part]], log[part])


def define_outputs(file: McapFile, outputs: list[Output], base: int = 0) -> None:
    """Define the topics, and their schemas from number `base` + 1 on."""
    for number in sorted({output.message for output in outputs}):
        message = MESSAGES[number]
        definition = message.definition.encode()
        file.define(mr.Schema(base + 1 + number, definition, "ros2msg", message.name))
    for output in outputs:
        schema = base + 1 + output.message
        file.define(mr.Channel(output.number, output.topic, "cdr", output.metadata, schema))


def topic_names(recording: Recording) -> dict[str, str]:
    """The topic of each channel: "/<triad>/imu", "temperature", "rest" or "accel" below it."""
    names = {}
    for name, channel in recording.channels.items():
        ending = channel.quantity if channel.quantity in ("temperature", REST) else "imu"
        ending = "accel" if channel.quantity.startswith(_SPUN) else ending
        names[name] = f"/{channel.triad}/{ending}"
    return names


class McapWriter:
    """The MCAP writer."""

    name = "mcap"
    suffixes = (".mcap",)

    def write_blocks(self, blocks: Iterable[Recording], path: Path) -> None:
        """Write block after block. Raises UsageError for a channel that no ROS message can hold,
        and ChannelsChange where the topics of the first block do not fit a later one."""
        outputs: list[Output] = []
        with McapFile(path) as file:
            for recording in blocks:
                if not outputs and recording.channels:
                    outputs = outputs_of(recording, topic_names(recording), 1)
                    file.marks(recording.corrections)
                    define_outputs(file, outputs)
                put_block(file, outputs, recording)


WRITER = McapWriter()
