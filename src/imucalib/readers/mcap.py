"""Recordings in MCAP: ROS 2, ROS 1, JSON and protobuf messages.

Every topic of type sensor_msgs/Imu becomes a triad; without any, topics with a field that is
named like an acceleration do. Split accelerometer and gyroscope topics are joined into one triad.

The scan is linear, needs no index and survives damage: every chunk is checked against its CRC, size
and time span. A damaged part costs only itself: the scan goes on at the next chunk whose two
lengths agree, and reports what was passed over. What a record holds is parsed by the package mcap;
the scan is our own, since that package ends at the first damage and unpacks without a bound.

Source: MCAP format specification, version 0 (https://mcap.dev/spec).
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, Footer, Metadata, Schema
from numpy.typing import NDArray

from imucalib.errors import UnreadableInput
from imucalib.readers.messages.recording import LogReader
from imucalib.readers.messages.records import (
    MESSAGE_HEAD,
    Damage,
    MessageBlock,
    MessageLog,
    Topic,
)
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import corrections_of

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEADER = struct.Struct("<BQ")
#: Name of the Metadata record that marks a corrected recording.
CORRECTIONS = "imucal corrections"
#: Bytes of a packed chunk's records unless --max-chunk says otherwise; writers use 1 to 4 MiB. A
#: header may lie, and 4 bytes of zstd may unpack to 128 KiB.
MAX_CHUNK = 64 << 20
_CUT_PIECE = 1 << 13  # bytes that are unpacked at a time where a chunk breaks off
#: The fewest bytes that the content of each record type has, from 0x01 on.
_SMALLEST = dict(enumerate((8, 20, 14, 16, 22, 40, 6, 60, 36, 44, 46, 8, 20, 17, 4), 1))
_USER_TYPES = 0x80  # record types from here on belong to others
_LARGEST = 1 << 40  # bytes: no record is longer
_LARGEST_MARK = 1 << 20  # a longer metadata record is not ours
_PEEK = 64  # bytes after a record's header that hold any chunk's head
_WINDOW = 1 << 22  # bytes that are searched, or walked through, at once
_INDEX_WINDOW = 1 << 17
_RUN_START = 8  # equal lengths in a row before a whole run is looked for
#: Each begins with a byte, which is searched for several times as fast as a lookahead alone.
_CHUNK_PATTERN = re.compile(
    rb"\x06(?=.{5}\x00{3}.{21}\x00{3}.{4}(?:\x00{4}|\x04\x00{3}zstd|\x03\x00{3}lz4).{5}\x00{3})",
    re.DOTALL,
)
_MESSAGE_PATTERN = re.compile(rb"\x05(?=.{3}\x00{5})", re.DOTALL)
#: Yields messages, returns where the next record begins.
_Steps = Generator[MessageBlock, None, int]


class MalformedRecordError(ValueError):
    """The bytes of a record contradict its type; the scan makes a `Damage` of it."""


class _Content(ReadDataStream):
    """The content of a record; EndOfFile where it is too short, and text of damaged UTF-8."""

    def read(self, length: int) -> bytes:
        data: bytes = super().read(length)
        if len(data) < length:
            raise EndOfFile
        return data

    def read_prefixed_string(self) -> str:
        return str(self.read(self.read4()), "utf-8", "replace")


def parse_record(kind: Any, content: bytes) -> Any:
    """A record of a type of `mcap.records`; raises MalformedRecordError."""
    try:
        return kind.read(_Content(BytesIO(content)))
    except EndOfFile as error:
        name = kind.__name__.lower()
        raise MalformedRecordError(f"a field runs past the end of a {name} record") from error


class ChunkHead(NamedTuple):
    """A chunk's record before its messages: size, crc : of these unpacked; body, packed : where the
    packed ones begin in the content, and their bytes."""

    first_ns: int
    last_ns: int
    size: int
    crc: int
    compression: str
    body: int
    packed: int

    @classmethod
    def of(cls, content: bytes) -> ChunkHead | None:
        """The head that the first bytes of a record are, or None."""
        if len(content) < 40:
            return None
        first, last, size, crc, name = struct.unpack_from("<QQQII", content)
        body = 40 + name
        if name > 16 or len(content) < body:
            return None
        compression = content[32 : body - 8].decode("ascii", "replace")
        packed = int.from_bytes(content[body - 8 : body], "little")
        return cls(
            first_ns=first,
            last_ns=last,
            size=size,
            crc=crc,
            compression=compression,
            body=body,
            packed=packed,
        )

    def plausible(self, length: int, slack: int = 0) -> bool:
        """Whether this heads a chunk record of a length: 64 bits that noise does not match."""
        fits = 0 <= length - self.body - self.packed <= slack
        return fits and self.first_ns <= self.last_ns and self.compression in ("", "zstd", "lz4")

    def unpacked(self, packed: bytes, most: int, *, cut: bool = False) -> bytes:
        """The records, their size and CRC checked; raises MalformedRecordError.

        most : bytes; a packed chunk that claims more is refused
        cut : the end is missing: what can be had of it, which nothing checks
        """
        if self.compression and self.size > most:
            what = f"the chunk claims {self.size} bytes, more than --max-chunk {most}"
            raise MalformedRecordError(what)
        # One byte more than is due shows that there is more.
        pieces, missing = list[bytes](), self.size + 1
        try:
            with self._open(packed) as stream:
                while piece := stream.read(min(missing, _CUT_PIECE) if cut else missing):
                    pieces.append(piece)
                    missing -= len(piece)
        except Exception as error:  # the two libraries raise unrelated types for damaged data
            if not cut:
                what = f"the {self.compression} data is damaged"
                raise MalformedRecordError(what) from error
        data = b"".join(pieces)
        if cut:
            return data if missing else b""
        if len(data) != self.size:
            raise MalformedRecordError("the chunk's size differs from its header")
        if self.crc and zlib.crc32(data) != self.crc:
            raise MalformedRecordError("the chunk's CRC differs from its header")
        return data

    def _open(self, packed: bytes) -> Any:
        if self.compression == "zstd":
            import zstandard

            unpacker = zstandard.ZstdDecompressor()
            return unpacker.stream_reader(packed, read_across_frames=True)
        if self.compression == "lz4":
            import lz4.frame

            return lz4.frame.LZ4FrameFile(BytesIO(packed))
        if self.compression:
            raise MalformedRecordError(f"unknown chunk compression {self.compression!r}")
        return BytesIO(packed)


class _Walk(NamedTuple):
    """Starts of message records, other records (opcode, start, stop), and where the walk ended."""

    starts: NDArray[np.int64]
    others: list[tuple[int, int, int]]
    end: int
    stopped: str  # why the walk ended before the last byte, or ""


def _walk(data: bytes) -> _Walk:
    """Find the records in a chunk's bytes: runs of equal-length messages as whole arrays.

    Stops before the first record that is incomplete or cannot belong into a chunk.
    """
    pieces: list[NDArray[np.int64]] = []
    single: list[int] = []
    others: list[tuple[int, int, int]] = []
    at, size, last, streak, stopped = 0, len(data), -1, 0, ""
    while at + 9 <= size:
        opcode, length = RECORD_HEADER.unpack_from(data, at)
        end = at + 9 + length
        if end > size:
            stopped = "a record runs past the end"
        elif opcode == Opcode.MESSAGE and length < MESSAGE_HEAD - 9:
            stopped = "a message is too short"
        elif opcode < _USER_TYPES and opcode not in (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL):
            stopped = f"unexpected record type 0x{opcode:02x}"
        if stopped:
            break
        if opcode != Opcode.MESSAGE:
            others.append((opcode, at + 9, end))
            at, streak = end, 0
            continue
        streak = streak + 1 if length == last else 0
        last = length
        if streak < _RUN_START:
            single.append(at)
            at = end
            continue
        run = _run(data, at, length)
        pieces += [np.array(single, dtype=np.int64), run]
        single, streak = [], 0
        at = int(run[-1]) + 9 + length
    else:
        stopped = "a record header is incomplete" if at < size else ""
    pieces.append(np.array(single, dtype=np.int64))
    return _Walk(np.concatenate(pieces), others, at, stopped)


def _run(data: bytes, at: int, length: int) -> NDArray[np.int64]:
    """Starts of the message records from `at` on that share its length."""
    stride = 9 + length
    rows = (len(data) - at) // stride
    head = np.dtype({"names": ["op", "len"], "formats": ["u1", "<u8"], "offsets": [0, 1]})
    view = np.ndarray((rows,), head, data, at, (stride,))
    count, look = 0, 64
    while count < rows:
        part = view[count : count + look]
        same = (part["len"] == length) & (part["op"] == Opcode.MESSAGE)
        good = len(same) if same.all() else int(same.argmin())
        count += good
        if good < len(same):
            break
        look *= 4
    return at + stride * np.arange(count, dtype=np.int64)


@dataclass
class _Definitions:
    """Schemas and topics by their numbers."""

    topics: dict[int, Topic]
    schemas: dict[int, Schema] = field(default_factory=dict)

    def add(self, opcode: int, content: bytes) -> str:
        """Take a record; returns how it contradicts an earlier one, or "". Others are passed over.

        Raises MalformedRecordError.
        """
        if opcode == Opcode.SCHEMA:
            schema = parse_record(Schema, content)
            if self.schemas.setdefault(schema.id, schema) != schema:
                return f"schema {schema.id} is defined twice, differently"
        elif opcode == Opcode.CHANNEL:
            own = parse_record(Channel, content)
            schema = self.schemas.get(own.schema_id)
            topic = Topic(own.id, own.topic, own.message_encoding, schema, own.metadata)
            if self.topics.setdefault(topic.id, topic) != topic:
                return f"channel {topic.id} is defined twice, differently"
        return ""


class McapLog(MessageLog):
    """An MCAP file as a log of messages.

    extras : attachments and metadata that the last pass met: opcode, first byte and size of content
    """

    format = "mcap"

    def __init__(self, path: Path, *, strict: bool = False, max_chunk: int | None = None) -> None:
        super().__init__(path, strict=strict)
        self._most = max_chunk or MAX_CHUNK

    def _begin(self) -> None:
        super()._begin()
        self.extras: list[tuple[int, int, int]] = []
        self._definitions = _Definitions(self.topics)
        self._messages = 0
        self._hidden: int | None = None  # the damage whose messages the next indexes can count
        self._chunks = False
        self._data_end = 0
        self._done = False

    def blocks(self) -> Iterator[MessageBlock]:
        """The messages in file order, a chunk at a time."""
        self._begin()
        with self.path.open("rb") as self._file:
            self._size = self._file.seek(0, 2)
            if self._read(0, len(MAGIC)) != MAGIC:
                raise UnreadableInput(
                    "this is not an MCAP file: its first 8 bytes are not the MCAP magic",
                    where=str(self.path),
                    remedy="check that the download or copy is complete",
                )
            at = len(MAGIC)
            while not self._done and at < self._size:
                try:
                    at = yield from self._step(at)
                except MalformedRecordError as error:
                    at = yield from self._recover(at, str(error))
            if not self._done:
                reason = "the file ends without its footer; it was not closed properly"
                self.report(Damage(at, 0, reason))

    def indexed_topics(self) -> dict[int, Topic]:
        """Topics of the file's summary; none where it is absent, cut or damaged."""
        found = _Definitions({})
        with self.path.open("rb") as file:
            size = file.seek(0, 2)
            file.seek(max(size - 37, 0))
            tail = file.read()
            start = int.from_bytes(tail[9:17], "little")
            whole = len(tail) == 37 and tail[0] == Opcode.FOOTER and tail.endswith(MAGIC)
            if not whole or not len(MAGIC) <= start < size:
                return {}
            file.seek(start)
            data = file.read(max(size - 37 - start, 0))
        crc = int.from_bytes(tail[25:29], "little")
        if crc and zlib.crc32(data + tail[:25]) != crc:
            return {}
        at = 0
        try:
            while at + 9 <= len(data):
                opcode, length = RECORD_HEADER.unpack_from(data, at)
                found.add(opcode, data[at + 9 : at + 9 + length])
                at += 9 + length
        except MalformedRecordError:
            return {}
        return found.topics

    # -- one record ---------------------------------------------------------------------------

    def _read(self, at: int, size: int) -> bytes:
        """Up to `size` bytes from `at` on; none past the end, where damaged lengths point."""
        if at >= self._size:
            return b""
        self._file.seek(at)
        return self._file.read(min(size, self._size - at))

    def _step(self, at: int) -> _Steps:
        """Read the record at `at`; the generator returns where the next one begins.

        Raises MalformedRecordError where that is not known.
        """
        peek = self._read(at, 9 + _PEEK)
        if len(peek) < 9:
            raise MalformedRecordError("a record header is incomplete")
        opcode, length = RECORD_HEADER.unpack_from(peek)
        end = at + 9 + length
        chunk = ChunkHead.of(peek[9:])
        if opcode != Opcode.CHUNK and chunk and chunk.plausible(length):
            self.report(Damage(at, 0, f"a chunk is marked as record type 0x{opcode:02x}"))
            opcode = Opcode.CHUNK
        if opcode not in _SMALLEST and opcode < _USER_TYPES:
            raise MalformedRecordError(f"unknown record type 0x{opcode:02x}")
        if opcode == Opcode.CHUNK:
            return (yield from self._chunk(at, end, chunk))
        if end > self._size:
            raise MalformedRecordError("a record runs past the end of the file")
        if opcode == Opcode.MESSAGE:
            return (yield from self._stretch(at, end))
        after = self._after_indexes(at)
        if after > at:
            return after
        if opcode != Opcode.FOOTER and not self._leads_on(end):
            raise MalformedRecordError("nothing readable follows a record")
        self._other(opcode, at, end)
        return int(end)

    def _stretch(self, at: int, end: int) -> _Steps:
        """Messages outside any chunk, a window at a time."""
        data = self._read(at, max(_WINDOW, end - at))
        walk = _walk(data)
        if not walk.end:
            raise MalformedRecordError(walk.stopped)
        yield from self._find(data, walk, at)
        return at + walk.end

    def _chunk(self, at: int, end: int, head: ChunkHead | None) -> _Steps:
        """A record may be longer than its content (padding); its length may also be wrong."""
        inner = at + 9 + head.body + head.packed if head else self._size + 1
        if not (inner <= end <= self._size and (inner == end or self._leads_on(end))):
            if inner > self._size or not self._leads_on(inner):
                raise MalformedRecordError("a chunk is cut, or its header damaged")
            self.report(Damage(at, 0, "the length of a chunk's record is wrong"))
            end = inner
        assert head is not None
        self._chunks, self._hidden = True, None
        span = (head.first_ns, head.last_ns)
        try:
            data = head.unpacked(self._read(at + 9 + head.body, head.packed), self._most)
        except MalformedRecordError as error:
            self._hidden = len(self.damages)
            self.report(Damage(at, end - at, str(error), *span))
            return end
        walk = _walk(data)
        for block in self._find(data, walk, at):
            times = block.header("log_time")
            if not walk.stopped and (int(times.min()), int(times.max())) != span:
                reason = "a chunk header's time span differs from its messages'"
                self.report(Damage(at, 0, reason))
            yield block
        if walk.stopped:
            reason = f"in a chunk, {walk.stopped}; the rest of it is lost"
            self.report(Damage(at, 0, reason, *span))
        return end

    def _find(self, data: bytes, walk: _Walk, at: int) -> Iterator[MessageBlock]:
        """Take the definitions of a chunk or stretch, and yield its messages if there are any."""
        for opcode, start, stop in walk.others:
            try:
                problem = self._definitions.add(opcode, data[start:stop])
            except MalformedRecordError as error:
                problem = str(error)
            if problem:
                self.report(Damage(at, 0, problem))
        if walk.starts.size:
            self._messages += walk.starts.size
            yield MessageBlock.of_records(data, walk.starts)

    def _other(self, opcode: int, at: int, end: int) -> None:
        """A record other than a chunk or message."""
        if opcode in (Opcode.ATTACHMENT, Opcode.METADATA):
            self.extras.append((opcode, at + 9, end - at - 9))
        if opcode == Opcode.ATTACHMENT or (opcode == Opcode.METADATA and end - at > _LARGEST_MARK):
            return
        content = self._read(at + 9, end - at - 9)
        if opcode == Opcode.MESSAGE_INDEX and self._hidden is not None:
            lost = self.damages[self._hidden]
            count = (lost.messages or 0) + int.from_bytes(content[2:6], "little") // 16
            self.damages[self._hidden] = replace(lost, messages=count)
        elif opcode == Opcode.METADATA:
            mark = parse_record(Metadata, content)
            if mark.name == CORRECTIONS:
                self.corrections += corrections_of(mark.metadata.values())
        problem = self._definitions.add(opcode, content) or self._ending(opcode, at, content)
        if problem:
            self.report(Damage(at, 0, problem))

    def _ending(self, opcode: int, at: int, content: bytes) -> str:
        """What a record after the last message contradicts, or ""."""
        if opcode == Opcode.DATA_END:
            self._data_end = at + 9 + len(content)
            expected = parse_record(DataEnd, content).data_section_crc
            if expected and expected != self._crc_before(at):
                return "the CRC of the whole data section differs from the file's bytes"
        elif opcode == Opcode.STATISTICS:
            declared = int.from_bytes(content[:8], "little")
            lost = [damage.messages for damage in self.damages if damage.size or damage.messages]
            if None not in lost and declared != self._messages + sum(n or 0 for n in lost):
                found = f"{self._messages} were found"
                return f"the file's statistics declare {declared} messages, {found}"
        elif opcode == Opcode.FOOTER:
            summary = parse_record(Footer, content).summary_start
            self._done = True
            end = at + 9 + len(content)
            if self._data_end == 0 or summary not in (0, self._data_end):
                return "records before the footer are missing: it names another place for them"
            if self._read(end, len(MAGIC) + 1) != MAGIC:
                return "the bytes after the footer are not the closing magic"
        return ""

    def _crc_before(self, stop: int) -> int:
        crc = 0
        for at in range(0, stop, _WINDOW):
            crc = zlib.crc32(self._read(at, min(_WINDOW, stop - at)), crc)
        return crc

    def _after_indexes(self, at: int) -> int:
        """Where the message indexes end that follow one another from `at` on and count no loss."""
        data = b"" if self._hidden is not None else self._read(at, _INDEX_WINDOW)
        here, size = 0, len(data)
        while here + 15 <= size and data[here] == Opcode.MESSAGE_INDEX:
            length, _, entries = struct.unpack_from("<QHI", data, here + 1)
            if length != 6 + entries or here + 9 + length > size:
                break
            here += 9 + length
        return at + here

    # -- damage -------------------------------------------------------------------------------

    def _recover(self, at: int, reason: str) -> _Steps:
        """Find where the file makes sense again; read a cut last chunk as far as it goes."""
        found = self._search(at + 1, _CHUNK_PATTERN, self._is_chunk)
        if found is None and not self._chunks:
            found = self._search(at + 1, _MESSAGE_PATTERN, self._is_run)
        if found is not None:
            self.report(Damage(at, found - at, reason))
            return found
        peek, data = self._read(at, 9 + _PEEK), b""
        head = ChunkHead.of(peek[9:])
        if peek.startswith(b"\x06") and head is not None:
            packed = self._read(at + 9 + head.body, self._size)
            with suppress(MalformedRecordError):
                data = head.unpacked(packed, self._most, cut=True)
        walk = _walk(data)
        blocks = list(self._find(data, walk, at))
        kept = f"; {walk.starts.size} messages of the cut chunk are kept" if data else ""
        span = (head.first_ns, head.last_ns) if head and data else (None, None)
        self.report(Damage(at, self._size - at, reason + kept, *span))
        yield from blocks
        return self._size

    def _leads_on(self, at: int) -> bool:
        """Whether two plausible records, or the file's end, begin at a byte."""
        for _ in range(2):
            header = self._read(at, 9)
            if len(header) < 9:
                return True
            opcode, length = RECORD_HEADER.unpack(header)
            if opcode < _USER_TYPES and length < _SMALLEST.get(opcode, _LARGEST):
                return False
            at += 9 + length
            if opcode == Opcode.FOOTER:
                return self._read(at, len(MAGIC)) == MAGIC
            if at > self._size:
                # The cut last record of a truncated file, or a length made of noise.
                return bool(length < _LARGEST)
        return True

    def _search(
        self, start: int, pattern: re.Pattern[bytes], check: Callable[[int], bool]
    ) -> int | None:
        """The first byte from `start` on where a pattern matches and a check agrees."""
        for at in range(start, self._size, _WINDOW):
            for match in pattern.finditer(self._read(at, _WINDOW + _PEEK)):
                if match.start() < _WINDOW and check(at + match.start()):
                    return at + match.start()
        return None

    def _is_chunk(self, at: int) -> bool:
        """Whether a chunk whose two lengths agree begins at a byte."""
        peek = self._read(at, 9 + _PEEK)
        head = ChunkHead.of(peek[9:])
        return head is not None and head.plausible(int.from_bytes(peek[1:9], "little"), _PEEK)

    def _is_run(self, at: int) -> bool:
        """Whether messages of known channels begin at a byte."""
        for _ in range(3):
            header = self._read(at, 11)
            if len(header) < 11:
                return len(header) == 0
            opcode, length = RECORD_HEADER.unpack_from(header)
            if opcode == Opcode.DATA_END:
                return bool(length == 4)
            known = int.from_bytes(header[9:11], "little") in self.topics
            if opcode != Opcode.MESSAGE or length < MESSAGE_HEAD - 9 or not known:
                return False
            at += 9 + length
        return at <= self._size


class McapReader(LogReader):
    """The MCAP reader."""

    name = "mcap"
    suffixes = (".mcap",)

    def recognises(self, path: Path, head: bytes) -> bool:
        """Whether the file begins with the MCAP magic."""
        return head.startswith(MAGIC)

    def open(self, path: Path, mapping: FieldMapping, *, strict: bool = False) -> McapLog:
        """The log; `mapping.max_chunk` is obeyed."""
        return McapLog(path, strict=strict, max_chunk=mapping.max_chunk)


READER = McapReader()
