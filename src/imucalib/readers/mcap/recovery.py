"""Where an MCAP file makes sense again after damage: tests that noise does not pass by chance."""

from __future__ import annotations

import re
from collections.abc import Callable, Container
from typing import BinaryIO

from imucalib.readers.messages import records as mr

PEEK = 64  # bytes after a record header that hold any chunk's head
_WINDOW = 1 << 22
_INDEX_WINDOW = 1 << 17
_LARGEST = 1 << 40  # no record is longer
#: The fewest bytes that the content of each record type has.
_SMALLEST = {
    0x01: 8, 0x02: 20, 0x03: 14, 0x04: 16, 0x05: 22, 0x06: 40, 0x07: 6, 0x08: 60, 0x09: 36,
    0x0A: 44, 0x0B: 46, 0x0C: 8, 0x0D: 20, 0x0E: 17, 0x0F: 4,
}  # fmt: skip
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
        for at in range(start, self.size, _WINDOW):
            window = self.read(at, _WINDOW + PEEK)
            for match in pattern.finditer(window):
                if match.start() < _WINDOW and check(at + match.start()):
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
