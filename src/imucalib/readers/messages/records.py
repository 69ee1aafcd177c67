"""Logs of messages, whatever file they are in: records of topics and messages, MCAP's summary.

Source: MCAP format specification, version 0 (https://mcap.dev/spec).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from imucalib.recording.recording import Correction, corrections_of

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
MESSAGE_INDEX, STATISTICS, DATA_END = 0x07, 0x0B, 0x0F
ATTACHMENT, METADATA = 0x09, 0x0C
#: Name of the Metadata record that marks a corrected recording.
CORRECTIONS = "imucal corrections"
COMPRESSIONS = ("", "zstd", "lz4")
RECORD_HEADER = struct.Struct("<BQ")
INDEX_HEAD = struct.Struct("<QHI")  # record length, channel, bytes of entries
MESSAGE_HEADER_SIZE = 22

_CHUNK_HEAD = struct.Struct("<QQQIL")
_U16, _U32, _U64 = struct.Struct("<H"), struct.Struct("<I"), struct.Struct("<Q")
#: A message record as seen from its first byte; the payload follows at byte 31.
_MESSAGE_HEAD = np.dtype(
    {
        "names": ["opcode", "length", "channel", "sequence", "log_time", "publish_time"],
        "formats": ["u1", "<u8", "<u2", "<u4", "<u8", "<u8"],
        "offsets": [0, 1, 9, 11, 15, 23],
        "itemsize": 31,
    }
)


class MalformedRecordError(ValueError):
    """The bytes of a record contradict its type; the scanner turns this into a `Damage`."""


class Schema(NamedTuple):
    """How the messages of a topic are described."""

    id: int
    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True)
class Topic:
    """An MCAP channel: the topic, how its messages are encoded, and their schema."""

    id: int
    name: str
    encoding: str
    schema: Schema | None
    metadata: tuple[tuple[str, str], ...] = ()

    @property
    def type_name(self) -> str:
        return self.schema.name if self.schema else "no schema"


@dataclass(frozen=True)
class Damage:
    """A part of the file that could not be read, or not be trusted.

    offset, size : bytes of the file; offset -1 when a container hides the place
    first_ns, last_ns : log times that the part's header claims, None when unknown
    messages : how many messages were lost, None when unknown
    """

    offset: int
    size: int
    reason: str
    first_ns: int | None = None
    last_ns: int | None = None
    messages: int | None = None

    def __str__(self) -> str:
        place = f"byte {self.offset}" if self.offset >= 0 else "a place that the index hides"
        text = f"{place}: {self.reason}"
        if self.size:
            text += f"; {self.size} bytes"
        if self.messages:
            text += f", {self.messages} messages"
        if self.first_ns is not None and self.last_ns is not None:
            text += f", {(self.last_ns - self.first_ns) * 1e-9:.6g} s of log time"
        return text + (" lost" if self.size or self.messages else "")


@dataclass(frozen=True)
class MessageBlock:
    """Messages of one chunk (or of a stretch of an unchunked file), in file order.

    data : the decompressed records
    starts, lengths : (n,) int64, where each payload begins in `data` and how long it is
    offset : the file byte where the block's chunk begins
    """

    data: bytes
    starts: NDArray[np.int64]
    lengths: NDArray[np.int64]
    offset: int

    def header(self, name: str) -> NDArray[np.uint64]:
        """(n,) one message header field: channel, sequence, log_time (ns), publish_time (ns)."""
        first = int(self.starts[0]) - 31 if self.starts.size else 0
        steps = np.diff(self.starts)
        if steps.size and steps[0] > 0 and (steps == steps[0]).all():
            strides = (int(steps[0]),)
            even = np.ndarray((self.starts.size,), _MESSAGE_HEAD, self.data, first, strides)
            return even[name].copy()
        return _rows(self.data)[name][self.starts - 31]

    def payloads(self) -> list[bytes]:
        """The payload of every message, for encodings that must be parsed one by one."""
        pairs = zip(self.starts.tolist(), (self.starts + self.lengths).tolist(), strict=True)
        return [self.data[a:b] for a, b in pairs]

    def take(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> MessageBlock:
        """The block restricted to some of its messages."""
        return MessageBlock(self.data, self.starts[rows], self.lengths[rows], self.offset)


class ChunkHead(NamedTuple):
    """The fields of a Chunk record before its compressed records."""

    first_ns: int
    last_ns: int
    uncompressed_size: int
    uncompressed_crc: int
    compression: str
    body: int  # where the compressed records begin, from the start of the content
    size: int  # how many bytes they have

    def plausible(self, length: int, slack: int = 0) -> bool:
        """Whether this heads a chunk record of a length: 64 bits that noise does not match."""
        fits = 0 <= length - self.body - self.size <= slack
        return fits and self.first_ns <= self.last_ns and self.compression in COMPRESSIONS


def parse_chunk_head(content: bytes) -> ChunkHead | None:
    """The head of a Chunk record, or None when the bytes cannot be one."""
    if len(content) < 40:
        return None
    first, last, size, crc, name_length = _CHUNK_HEAD.unpack_from(content)
    if name_length > 16 or len(content) < 40 + name_length:
        return None
    name = content[32 : 32 + name_length]
    (inner,) = _U64.unpack_from(content, 32 + name_length)
    text = name.decode("ascii", "replace")
    return ChunkHead(
        first_ns=first,
        last_ns=last,
        uncompressed_size=size,
        uncompressed_crc=crc,
        compression=text,
        body=40 + name_length,
        size=inner,
    )


def text_at(content: bytes, at: int) -> tuple[str, int]:
    """The string at a byte of a record, and where it ends; raises MalformedRecordError."""
    raw, end = _blob(content, at)
    return raw.decode("utf-8", "replace"), end


def _blob(content: bytes, at: int) -> tuple[bytes, int]:
    if at + 4 > len(content):
        raise MalformedRecordError("a field runs past the end of its record")
    end = at + 4 + int(_U32.unpack_from(content, at)[0])
    if end > len(content):
        raise MalformedRecordError("a field runs past the end of its record")
    return content[at + 4 : end], end


def parse_schema(content: bytes) -> Schema:
    """A Schema record; raises MalformedRecordError."""
    if len(content) < 2:
        raise MalformedRecordError("a schema record is too short")
    name, at = text_at(content, 2)
    encoding, at = text_at(content, at)
    data, _ = _blob(content, at)
    return Schema(int(_U16.unpack_from(content)[0]), name, encoding, data)


def parse_channel(content: bytes, schemas: dict[int, Schema]) -> Topic:
    """A Channel record, its schema looked up; raises MalformedRecordError."""
    if len(content) < 4:
        raise MalformedRecordError("a channel record is too short")
    name, at = text_at(content, 4)
    encoding, at = text_at(content, at)
    pairs = _pairs(content, at)
    number, schema = struct.unpack_from("<HH", content)
    return Topic(number, name, encoding, schemas.get(schema), pairs)


def _pairs(content: bytes, at: int) -> tuple[tuple[str, str], ...]:
    packed, _ = _blob(content, at)
    pairs, at = [], 0
    while at < len(packed):
        key, at = text_at(packed, at)
        value, at = text_at(packed, at)
        pairs.append((key, value))
    return tuple(pairs)


def parse_corrections(content: bytes) -> tuple[Correction, ...]:
    """What a Metadata record of ours says of corrections; raises MalformedRecordError."""
    name, at = text_at(content, 0)
    return corrections_of(v for _, v in _pairs(content, at)) if name == CORRECTIONS else ()


def index_count(content: bytes) -> int:
    """How many messages a MessageIndex record lists; raises MalformedRecordError."""
    if len(content) < 6:
        raise MalformedRecordError("a message index is too short")
    return int(_U32.unpack_from(content, 2)[0]) // 16


def _rows(data: bytes) -> NDArray[np.void]:
    """A message header at every byte of the block, so that any start can be gathered."""
    return np.ndarray((max(len(data) - 30, 0),), _MESSAGE_HEAD, data, 0, (1,))


def message_block(data: bytes, starts: NDArray[np.int64], offset: int) -> MessageBlock:
    """The messages whose records start at `starts` in `data`."""
    lengths = _rows(data)["length"][starts].astype(np.int64) - MESSAGE_HEADER_SIZE
    return MessageBlock(data, starts + 31, lengths, offset)


class Summary(NamedTuple):
    """Channels by number, and message counts by channel number."""

    topics: dict[int, Topic]
    counts: dict[int, int]


def read_summary(path: Path) -> Summary:
    """The summary; empty when it is absent, cut or damaged."""
    with open(path, "rb") as file:
        size = file.seek(0, 2)
        file.seek(max(size - 37, 0))
        tail = file.read()
        if len(tail) < 37 or tail[0] != FOOTER or tail[-8:] != MAGIC:
            return Summary({}, {})
        summary = int.from_bytes(tail[9:17], "little")
        if not len(MAGIC) <= summary < size:
            return Summary({}, {})
        file.seek(summary)
        data = file.read(size - 37 - summary)
    expected = int.from_bytes(tail[25:29], "little")
    if expected and zlib.crc32(data + tail[:25]) != expected:
        return Summary({}, {})
    return _parsed(data)


def _parsed(data: bytes) -> Summary:
    schemas: dict[int, Schema] = {}
    topics: dict[int, Topic] = {}
    counts: dict[int, int] = {}
    at = 0
    try:
        while at + 9 <= len(data):
            opcode, length = RECORD_HEADER.unpack_from(data, at)
            content = data[at + 9 : at + 9 + length]
            if opcode == SCHEMA:
                schema = parse_schema(content)
                schemas[schema.id] = schema
            elif opcode == CHANNEL:
                topic = parse_channel(content, schemas)
                topics[topic.id] = topic
            elif opcode == STATISTICS:
                pairs = content[46 : 46 + len(content[46:]) // 10 * 10]
                counts = dict(struct.iter_unpack("<HQ", pairs))
            at += 9 + length
    except MalformedRecordError:
        return Summary({}, {})
    return Summary(topics, counts)


class Scan(Protocol):
    """One pass over a log: `topics` (by channel number), `damages` and `corrections` fill
    meanwhile."""

    topics: dict[int, Topic]
    damages: list[Damage]
    corrections: tuple[Correction, ...]

    def blocks(self) -> Iterator[MessageBlock]:
        """The messages in file order, some thousand at a time."""
        ...


class MessageLog(Protocol):
    """A file, or a folder of files, that holds messages."""

    @property
    def format(self) -> str:
        """Name of the reader, stored in `Recording.format`."""
        ...

    @property
    def path(self) -> Path:
        """The file or folder."""
        ...

    def scan(self, *, strict: bool) -> Scan:
        """Begin a pass; with `strict` the first damage raises UnreadableInput."""
        ...

    def summary(self) -> Summary:
        """Topics and counts that are known without a pass; nothing depends on them."""
        ...

    def sha256(self) -> str:
        """SHA-256 of the content as lower-case hex."""
        ...
