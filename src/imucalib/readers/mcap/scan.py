"""A linear scan of an MCAP file that needs no index and survives damage.

Every chunk is checked against its CRC, size and time span. A damaged part costs only itself:
the scan goes on at the next chunk whose two lengths agree, and reports what was passed over.
"""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Generator, Iterator
from pathlib import Path

from imucalib.errors import UnreadableInput
from imucalib.readers.mcap.chunks import MAX_CHUNK, unpack_chunk, unpack_cut_chunk
from imucalib.readers.mcap.recovery import PEEK, FileBytes
from imucalib.readers.mcap.walk import Walk
from imucalib.readers.mcap.walk import walk as walk_records
from imucalib.readers.messages import records as mr
from imucalib.readers.messages.records import (
    Damage,
    MalformedRecordError,
    MessageBlock,
    Schema,
    Topic,
)
from imucalib.recording.correction import Correction

#: Yields messages, returns where the next record begins.
_Steps = Generator[MessageBlock, None, int]
_WINDOW = 1 << 22
_LARGEST_MARK = 1 << 20  # a longer metadata record is not ours
_KNOWN = range(0x01, 0x10)


class Scanner:
    """One pass over a file: `blocks` yields the messages, `topics` and `damages` fill meanwhile.

    With `strict` the first damage raises UnreadableInput; max_chunk : bytes, see `chunks`.
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
