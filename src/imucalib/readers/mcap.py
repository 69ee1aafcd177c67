"""Recordings in MCAP: ROS 2, ROS 1, JSON and protobuf messages.

Every topic of type sensor_msgs/Imu becomes a triad; without any, topics whose field names tell of
an acceleration do. Split accelerometer and gyroscope topics are joined into one triad.

The scan is linear, needs no index and survives damage: every chunk is checked against its CRC, size
and time span. A damaged part costs only itself: the scan goes on at the next chunk whose two
lengths agree, and reports what was passed over.
"""

from __future__ import annotations

import dataclasses
import re
import zlib
from collections.abc import Callable, Container, Generator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucalib.errors import UnreadableInput
from imucalib.readers.messages import records as mr
from imucalib.readers.messages.recording import log_blocks, read_log
from imucalib.readers.messages.records import (
    CHANNEL,
    COMPRESSIONS,
    MAGIC,
    MESSAGE,
    MESSAGE_HEADER_SIZE,
    RECORD_HEADER,
    SCHEMA,
    ChunkHead,
    Damage,
    MalformedRecordError,
    MessageBlock,
    Schema,
    Summary,
    Topic,
    read_summary,
)
from imucalib.readers.source import sha256_of
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Correction, Recording

#: Bytes of a packed chunk's records unless --max-chunk says otherwise; writers use 1 to 4 MiB. A
#: header may lie, and 4 bytes of zstd may stand for 128 KiB.
MAX_CHUNK = 64 << 20
_LZ4_MOST = 256  # an LZ4 block cannot expand further than 255 times
_PIECE = 1 << 16


def unpack_chunk(head: ChunkHead, body: bytes, most: int = MAX_CHUNK) -> bytes:
    """The records of a whole chunk, size and CRC checked; raises MalformedRecordError.

    most : bytes; a packed chunk that claims more is refused
    """
    _judge(head, body, most)
    try:
        # One byte more than is due shows that there is more.
        data = b"".join(_unpacked(head.compression, body, head.uncompressed_size + 1))
    except Exception as error:  # the two libraries raise unrelated types for damaged data
        raise MalformedRecordError(f"the {head.compression} data is damaged") from error
    if len(data) != head.uncompressed_size:
        raise MalformedRecordError("the chunk's size differs from its header")
    if head.uncompressed_crc and zlib.crc32(data) != head.uncompressed_crc:
        raise MalformedRecordError("the chunk's CRC differs from its header")
    return data


def unpack_cut_chunk(head: ChunkHead, body: bytes, most: int = MAX_CHUNK) -> bytes:
    """What can be decompressed of a chunk whose end is missing; nothing checks it."""
    try:
        _judge(head, body, most)
    except MalformedRecordError:
        return b""
    pieces: list[bytes] = []
    left = head.uncompressed_size
    try:
        for piece in _unpacked(head.compression, body, left + 1, _PIECE):
            pieces.append(piece)
            left -= len(piece)
            if left < 0:
                return b""
    except Exception:  # what came before the damage is kept
        pass
    return b"".join(pieces)


def _judge(head: ChunkHead, body: bytes, most: int) -> None:
    size = head.uncompressed_size
    if head.compression not in COMPRESSIONS:
        raise MalformedRecordError(f"unknown chunk compression {head.compression!r}")
    if head.compression and size > most:
        raise MalformedRecordError(f"the chunk claims {size} bytes, more than --max-chunk {most}")
    if head.compression == "lz4" and size > _LZ4_MOST * len(body):
        raise MalformedRecordError("the chunk's size differs from its header")


def _unpacked(compression: str, body: bytes, most: int, piece: int = 0) -> Iterator[bytes]:
    """At most `most` bytes of content, in pieces."""
    if compression == "":
        yield body
        return
    piece = piece or most
    if compression == "lz4":
        import lz4.frame

        unpacker = lz4.frame.LZ4FrameDecompressor()
        feed = body
        while most > 0 and not unpacker.eof:
            part = unpacker.decompress(feed, max_length=min(most, piece))
            feed, most = b"", most - len(part)
            yield part
            if not part and unpacker.needs_input:
                return
        return
    from imucalib.readers import zstd

    yield from zstd.frames(body, most, piece)


PEEK = 64  # bytes after a record header that hold any chunk's head
_SEARCHED = 1 << 22
_INDEX_WINDOW = 1 << 17
_LARGEST = 1 << 40  # no record is longer
#: The fewest bytes that the content of each record type has.
_SMALLEST = {
    0x01: 8,
    0x02: 20,
    0x03: 14,
    0x04: 16,
    0x05: 22,
    0x06: 40,
    0x07: 6,
    0x08: 60,
    0x09: 36,
    0x0A: 44,
    0x0B: 46,
    0x0C: 8,
    0x0D: 20,
    0x0E: 17,
    0x0F: 4,
}
#: Each begins with a byte, which is searched for several times as fast as a lookahead alone.
_CHUNK_PATTERN = re.compile(
    rb"\x06(?=.{5}\x00{3}.{21}\x00{3}.{4}(?:\x00{4}|\x04\x00{3}zstd|\x03\x00{3}lz4).{5}\x00{3})",
    re.DOTALL,
)
_MESSAGE_PATTERN = re.compile(rb"\x05(?=.{3}\x00{5})", re.DOTALL)


class FileBytes:
    """Random access to a file's bytes, and what can be recognised in them."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.size = file.seek(0, 2)

    def read(self, at: int, size: int) -> bytes:
        """Up to `size` bytes from `at` on; none past the end, where damaged lengths point."""
        if at >= self.size:
            return b""
        self._file.seek(at)
        return self._file.read(min(size, self.size - at))

    def leads_on(self, at: int) -> bool:
        """Whether two plausible records, or the file's end, begin at a byte."""
        for _ in range(2):
            header = self.read(at, 9)
            if len(header) < 9:
                return True
            opcode, length = mr.RECORD_HEADER.unpack(header)
            if opcode < 0x80 and (opcode not in _SMALLEST or length < _SMALLEST[opcode]):
                return False
            at += 9 + length
            if opcode == mr.FOOTER:
                return self.read(at, len(mr.MAGIC)) == mr.MAGIC
            if at > self.size:
                # The cut last record of a truncated file, or a length made of noise.
                return bool(length < _LARGEST)
        return True

    def after_indexes(self, at: int) -> int:
        """Where the message indexes end that stand in a row from `at` on."""
        data = self.read(at, _INDEX_WINDOW)
        here, size = 0, len(data)
        while here + 15 <= size and data[here] == mr.MESSAGE_INDEX:
            length, _, entries = mr.INDEX_HEAD.unpack_from(data, here + 1)
            if length != 6 + entries or here + 9 + length > size:
                break
            here += 9 + length
        return at + here

    def chunk_end(self, at: int, head: mr.ChunkHead | None) -> tuple[int, bool] | None:
        """Where the record after the chunk at `at` begins, and whether its lengths agree.

        A record may be longer than its content (padding); a length may also be wrong.
        """
        if head is None:
            return None
        end = at + 9 + int.from_bytes(self.read(at + 1, 8), "little")
        inner = at + 9 + head.body + head.size
        if inner <= end <= self.size and (inner == end or self.leads_on(end)):
            return end, True
        return (inner, False) if inner <= self.size and self.leads_on(inner) else None

    def next_chunk(self, start: int) -> int | None:
        """The next chunk whose two lengths agree, from `start` on."""
        return self._scan(start, _CHUNK_PATTERN, self._is_chunk)

    def next_messages(self, start: int, channels: Container[int]) -> int | None:
        """The next run of messages of known channels, from `start` on."""
        return self._scan(start, _MESSAGE_PATTERN, lambda at: self._is_run(at, channels))

    def _scan(
        self, start: int, pattern: re.Pattern[bytes], check: Callable[[int], bool]
    ) -> int | None:
        for at in range(start, self.size, _SEARCHED):
            window = self.read(at, _SEARCHED + PEEK)
            for match in pattern.finditer(window):
                if match.start() < _SEARCHED and check(at + match.start()):
                    return at + match.start()
        return None

    def _is_chunk(self, at: int) -> bool:
        length = int.from_bytes(self.read(at + 1, 8), "little")
        head = mr.parse_chunk_head(self.read(at + 9, PEEK))
        return head is not None and head.plausible(length, slack=PEEK)

    def _is_run(self, at: int, channels: Container[int]) -> bool:
        for _ in range(3):
            header = self.read(at, 11)
            if len(header) < 11:
                return len(header) == 0
            opcode, length = mr.RECORD_HEADER.unpack_from(header)
            if opcode == mr.DATA_END:
                return bool(length == 4)
            known = int.from_bytes(header[9:11], "little") in channels
            if opcode != mr.MESSAGE or length < mr.MESSAGE_HEADER_SIZE or not known:
                return False
            at += 9 + length
        return at <= self.size


_RUN_START = 8  # equal lengths in a row before a whole run is looked for


class Walk(NamedTuple):
    """Starts of message records, other records (opcode, start, stop), and where the walk ended."""

    starts: NDArray[np.int64]
    others: list[tuple[int, int, int]]
    end: int
    stopped: str  # why the walk ended before the last byte, or ""


def walk_records(data: bytes) -> Walk:
    """Find the records in a chunk's bytes: runs of equal-length messages as whole arrays.

    Stops before the first record that is incomplete or cannot belong into a chunk.
    """
    pieces: list[NDArray[np.int64]] = []
    single: list[int] = []
    others: list[tuple[int, int, int]] = []
    at, size, last, streak, stopped = 0, len(data), -1, 0, ""
    unpack = RECORD_HEADER.unpack_from
    while at + 9 <= size:
        opcode, length = unpack(data, at)
        end = at + 9 + length
        if end > size or (opcode == MESSAGE and length < MESSAGE_HEADER_SIZE):
            stopped = "a record runs past the end" if end > size else "a message is too short"
            break
        if opcode != MESSAGE:
            if opcode not in (SCHEMA, CHANNEL) and opcode < 0x80:
                stopped = f"unexpected record type 0x{opcode:02x}"
                break
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
    return Walk(np.concatenate(pieces), others, at, stopped)


def _run(data: bytes, at: int, length: int) -> NDArray[np.int64]:
    """Starts of the message records from `at` on that share its length."""
    stride = 9 + length
    rows = (len(data) - at) // stride
    head = np.dtype({"names": ["op", "len"], "formats": ["u1", "<u8"], "offsets": [0, 1]})
    view = np.ndarray((rows,), head, data, at, (stride,))
    count, look = 0, 64
    while count < rows:
        part = view[count : count + look]
        same = (part["len"] == length) & (part["op"] == MESSAGE)
        good = len(same) if same.all() else int(same.argmin())
        count += good
        if good < len(same):
            break
        look *= 4
    return at + stride * np.arange(count, dtype=np.int64)


#: Yields messages, returns where the next record begins.
_Steps = Generator[MessageBlock, None, int]
_WINDOW = 1 << 22
_LARGEST_MARK = 1 << 20  # a longer metadata record is not ours
_KNOWN = range(0x01, 0x10)


class Scanner:
    """One pass over a file: `blocks` yields the messages, `topics` and `damages` fill meanwhile.

    With `strict` the first damage raises UnreadableInput; max_chunk : bytes, see `MAX_CHUNK`.
    """

    def __init__(self, path: Path, *, strict: bool = False, max_chunk: int | None = None) -> None:
        self.path, self.strict, self._most = path, strict, max_chunk or MAX_CHUNK
        self.topics: dict[int, Topic] = {}
        self.damages: list[Damage] = []
        self.messages = 0
        self.extras: list[tuple[int, int, int]] = []  # attachments, metadata: opcode, byte, size
        self.corrections: tuple[Correction, ...] = ()
        self._schemas: dict[int, Schema] = {}
        self._hidden: int | None = None  # the damage whose messages the next indexes can count
        self._chunks = 0
        self._done = False
        self._crc: int | None = None

    def blocks(self) -> Iterator[MessageBlock]:
        """The messages in file order, a chunk at a time."""
        with open(self.path, "rb") as file:
            self._bytes = FileBytes(file)
            if self._read(0, len(mr.MAGIC)) != mr.MAGIC:
                raise UnreadableInput(
                    "this is not an MCAP file: its first 8 bytes are not the MCAP magic",
                    where=str(self.path),
                    remedy="check that the download or copy is complete",
                )
            at = len(mr.MAGIC)
            while not self._done and at < self._bytes.size:
                at = yield from self._step(at)
            if not self._done:
                self._report(at, 0, "the file ends without its footer; it was not closed properly")

    # -- one record ---------------------------------------------------------------------------

    def _step(self, at: int) -> _Steps:
        """Read the record at `at`; the generator returns where the next one begins."""
        peek = self._read(at, 9 + PEEK)
        if len(peek) < 9:
            return (yield from self._recover(at, "a record header is incomplete"))
        opcode, length = mr.RECORD_HEADER.unpack_from(peek)
        end = at + 9 + length
        chunk = mr.parse_chunk_head(peek[9:])
        if opcode != mr.CHUNK and chunk and chunk.plausible(length):
            self._report(at, 0, f"a chunk is marked as record type 0x{opcode:02x}")
            opcode = mr.CHUNK
        if opcode not in _KNOWN and opcode < 0x80:
            return (yield from self._recover(at, f"unknown record type 0x{opcode:02x}"))
        if opcode == mr.CHUNK:
            return (yield from self._chunk(at, chunk))
        if end > self._bytes.size:
            return (yield from self._recover(at, "a record runs past the end of the file"))
        return (yield from self._whole(opcode, at, end))

    def _whole(self, opcode: int, at: int, end: int) -> _Steps:
        """A record other than a chunk that lies within the file."""
        if opcode == mr.MESSAGE:
            return (yield from self._loose(at))
        if opcode == mr.MESSAGE_INDEX and self._hidden is None:
            after = self._bytes.after_indexes(at)
            if after > at:
                return after
        try:
            if opcode != mr.FOOTER and not self._bytes.leads_on(end):
                raise MalformedRecordError("nothing readable follows a record")
            self._other(opcode, at, end)
        except MalformedRecordError as error:
            return (yield from self._recover(at, str(error)))
        return end

    def _chunk(self, at: int, head: mr.ChunkHead | None) -> _Steps:
        found = self._bytes.chunk_end(at, head)
        if head is None or found is None:
            return (yield from self._recover(at, "a chunk is cut, or its header damaged"))
        end, agreed = found
        if not agreed:
            self._report(at, 0, "the length of a chunk's record is wrong")
        self._chunks += 1
        self._hidden = None
        try:
            data = unpack_chunk(head, self._read(at + 9 + head.body, head.size), self._most)
        except MalformedRecordError as error:
            self._hidden = len(self.damages)
            self._report(at, end - at, str(error), head)
            return end
        yield from self._records(data, at, head)
        return end

    def _records(self, data: bytes, at: int, head: mr.ChunkHead) -> Iterator[MessageBlock]:
        walk = walk_records(data)
        self._define(data, walk, at)
        block = mr.message_block(data, walk.starts, at)
        if walk.stopped:
            self._report(at, 0, f"in a chunk, {walk.stopped}; the rest of it is lost", head)
        elif walk.starts.size:
            times = block.header("log_time")
            if (int(times.min()), int(times.max())) != (head.first_ns, head.last_ns):
                self._report(at, 0, "a chunk header's time span differs from its messages'")
        if walk.starts.size:
            self.messages += walk.starts.size
            yield block

    def _loose(self, at: int) -> _Steps:
        """Messages outside any chunk, a window at a time."""
        _, length = mr.RECORD_HEADER.unpack(self._read(at, 9))
        data = self._read(at, max(_WINDOW, 9 + length))
        walk = walk_records(data)
        if walk.end == 0:
            return (yield from self._recover(at, walk.stopped))
        self._define(data, walk, at)
        if walk.starts.size:
            self.messages += walk.starts.size
            yield mr.message_block(data, walk.starts, at)
        return at + walk.end

    def _other(self, opcode: int, at: int, end: int) -> None:
        if opcode in (mr.SCHEMA, mr.CHANNEL):
            self._declare(opcode, self._read(at + 9, end - at - 9), at)
        elif opcode == mr.MESSAGE_INDEX and self._hidden is not None:
            lost = self.damages[self._hidden]
            count = (lost.messages or 0) + mr.index_count(self._read(at + 9, 6))
            self.damages[self._hidden] = dataclasses.replace(lost, messages=count)
        elif opcode in (mr.ATTACHMENT, mr.METADATA):
            self.extras.append((opcode, at + 9, end - at - 9))
            if opcode == mr.METADATA and end - at < _LARGEST_MARK:
                self.corrections += mr.parse_corrections(self._read(at + 9, end - at - 9))
        elif opcode == mr.DATA_END:
            self._check_data_end(at, end)
        elif opcode == mr.STATISTICS:
            self._check_count(at)
        elif opcode == mr.FOOTER:
            if end - at < 29:
                raise MalformedRecordError("the footer is too short")
            tail = self._read(end, len(mr.MAGIC) + 1)
            if tail != mr.MAGIC:
                self._report(end, 0, "the bytes after the footer are not the closing magic")
            self._done = True

    # -- definitions and checks ---------------------------------------------------------------

    def _define(self, data: bytes, walk: Walk, at: int) -> None:
        for opcode, start, stop in walk.others:
            if opcode in (mr.SCHEMA, mr.CHANNEL):
                try:
                    self._declare(opcode, data[start:stop], at)
                except MalformedRecordError as error:
                    self._report(at, 0, str(error))

    def _declare(self, opcode: int, content: bytes, at: int) -> None:
        if opcode == mr.SCHEMA:
            schema = mr.parse_schema(content)
            if self._schemas.setdefault(schema.id, schema) != schema:
                self._report(at, 0, f"schema {schema.id} is defined twice, differently")
            return
        topic = mr.parse_channel(content, self._schemas)
        if self.topics.setdefault(topic.id, topic) != topic:
            self._report(at, 0, f"channel {topic.id} is defined twice, differently")

    def _check_data_end(self, at: int, end: int) -> None:
        content = self._read(at + 9, min(end - at - 9, 4))
        if len(content) < 4:
            raise MalformedRecordError("the end-of-data record is too short")
        expected = int.from_bytes(content, "little")
        if expected and expected != self._data_crc(at):
            self._report(at, 0, "the CRC of the whole data section differs from the file's bytes")

    def _data_crc(self, stop: int) -> int:
        crc = 0
        for at in range(0, stop, _WINDOW):
            crc = zlib.crc32(self._read(at, min(_WINDOW, stop - at)), crc)
        return crc

    def _check_count(self, at: int) -> None:
        declared = int.from_bytes(self._read(at + 9, 8), "little")
        lost = [damage.messages for damage in self.damages if damage.size or damage.messages]
        if None not in lost and declared != self.messages + sum(n or 0 for n in lost):
            text = f"the file's statistics declare {declared} messages, {self.messages} were found"
            self._report(at, 0, text)

    # -- damage -------------------------------------------------------------------------------

    def _report(self, at: int, size: int, reason: str, head: mr.ChunkHead | None = None) -> None:
        span = (head.first_ns, head.last_ns) if head else (None, None)
        damage = Damage(at, size, reason, *span)
        self.damages.append(damage)
        if self.strict:
            raise UnreadableInput(
                f"damaged at {damage}",
                where=str(self.path),
                remedy="read it without the strict option to keep what is intact",
            )

    def _recover(self, at: int, reason: str) -> _Steps:
        """Find where the file makes sense again; read a cut last chunk as far as it goes."""
        found = self._search(at + 1)
        if found is not None:
            self._report(at, found - at, reason)
            return found
        peek = self._read(at, 9 + PEEK)
        head = mr.parse_chunk_head(peek[9:])
        data = b""
        if peek[:1] == bytes([mr.CHUNK]) and head is not None:
            begin = at + 9 + head.body
            data = unpack_cut_chunk(head, self._read(begin, self._bytes.size - begin), self._most)
        walk = walk_records(data)
        self._define(data, walk, at)
        self.messages += walk.starts.size
        kept = f"; {walk.starts.size} messages of the cut chunk are kept" if data else ""
        self._report(at, self._bytes.size - at, reason + kept, head if data else None)
        if walk.starts.size:
            yield mr.message_block(data, walk.starts, at)
        return self._bytes.size

    def _search(self, start: int) -> int | None:
        """The next intact chunk; in a file without chunks, the next messages."""
        found = self._bytes.next_chunk(start)
        if found is None and not self._chunks:
            found = self._bytes.next_messages(start, self.topics)
        return found

    def _read(self, at: int, size: int) -> bytes:
        return self._bytes.read(at, size)


@dataclass(frozen=True)
class McapLog:
    """An MCAP file as a log of messages."""

    path: Path
    max_chunk: int | None = None
    format: str = "mcap"

    def scan(self, *, strict: bool) -> Scanner:
        """A linear scan that needs no index."""
        return Scanner(self.path, strict=strict, max_chunk=self.max_chunk)

    def summary(self) -> Summary:
        """What the file's own summary says; empty when it is absent or damaged."""
        return read_summary(self.path)

    def sha256(self) -> str:
        """Hash of the file."""
        return sha256_of(self.path)


class McapReader:
    """The MCAP reader."""

    name = "mcap"
    suffixes = (".mcap",)

    def recognises(self, path: Path, head: bytes) -> bool:
        """Whether the file begins with the MCAP magic."""
        return head.startswith(MAGIC)

    def read(self, path: Path, mapping: FieldMapping, *, strict: bool) -> Recording:
        """Read all samples in one pass."""
        return read_log(McapLog(path, mapping.max_chunk), mapping, strict=strict)

    def blocks(
        self, path: Path, mapping: FieldMapping, *, block_samples: int, strict: bool
    ) -> Iterator[Recording]:
        """Read the file twice, in bounded memory."""
        log = McapLog(path, mapping.max_chunk)
        yield from log_blocks(log, mapping, block_samples=block_samples, strict=strict)


READER = McapReader()
