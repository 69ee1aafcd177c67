"""A device's file as a stream, plain or gzipped, and where its packing breaks off.

gzip ends with a checksum and the length of what it holds (RFC 1952): a stream that is cut, be it
between two sectors, or whose bytes changed is told, and gives what comes before.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from imucalib.errors import UnreadableInput

_GZIP, _GZIP_BITS = b"\x1f\x8b", 31
_FEED = 1 << 10  # packed bytes at a time: what stands before damage in them is lost with them
_PLAIN = 1 << 16


@dataclass
class Stream:
    """Bytes of a file. lost : gets a sentence when they end too early"""

    pieces: Iterator[bytes]
    where: str
    strict: bool
    lost: list[str]
    ahead: bytes = b""
    passed: int = 0

    def read(self, size: int) -> bytes:
        """The next `size` bytes; fewer at the end, or where the packing breaks off.

        Raises UnreadableInput there with `strict`.
        """
        held, parts = len(self.ahead), [self.ahead]
        while held < size and (piece := self._next()) is not None:
            parts.append(piece)
            held += len(piece)
        whole = b"".join(parts)
        self.ahead = whole[size:]
        return whole[:size]

    def _next(self) -> bytes | None:
        try:
            piece = next(self.pieces, None)
        except (OSError, EOFError, zlib.error) as error:
            what = f"the file breaks off after {self.passed} bytes of its content: {error}"
            if self.strict:
                raise UnreadableInput(
                    what, where=self.where, remedy="copy the file from the device again"
                ) from None
            self.lost.append(what)
            return None
        self.passed += len(piece or b"")
        return piece


def head_unpacked(head: bytes, size: int) -> bytes:
    """The file's first bytes, at most `size` of them where they are packed; none if damaged."""
    if not head.startswith(_GZIP):
        return head
    try:
        return zlib.decompressobj(_GZIP_BITS).decompress(head, size)
    except zlib.error:
        return b""


@contextmanager
def opened(path: Path, *, strict: bool, lost: list[str]) -> Iterator[Stream]:
    """The file's bytes, unpacked where they are gzipped."""
    with path.open("rb") as raw:
        packed = raw.read(2) == _GZIP
        raw.seek(0)
        pieces = _unpacked(raw) if packed else iter(lambda: raw.read(_PLAIN), b"")
        yield Stream(pieces, str(path), strict, lost)


def _unpacked(raw: BinaryIO) -> Iterator[bytes]:
    """The content of gzip streams that follow each other; raises EOFError for one without end."""
    unpacker = zlib.decompressobj(_GZIP_BITS)
    while piece := raw.read(_FEED):
        while piece:
            if unpacker.eof:
                unpacker = zlib.decompressobj(_GZIP_BITS)
            yield unpacker.decompress(piece)
            # Zeros behind the end fill a block of a tape or a disk.
            piece = unpacker.unused_data.lstrip(b"\0") if unpacker.eof else b""
    if not unpacker.eof:
        raise EOFError("gzip's end mark is missing")
