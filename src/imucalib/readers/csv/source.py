"""Bytes of a text table: plain, gzip or UTF-16; pieces for a look at it, blocks of whole lines."""

from __future__ import annotations

import codecs
import gzip
import io
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np

from imucalib.errors import UnreadableInput

_GZIP = b"\x1f\x8b"
_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_PIECE = 1 << 16  # bytes of one look
_LONGEST_LINE = 1 << 20
_HEAD = 1 << 18  # unpacked bytes of the first look
_LOOKS = 24  # looks spread over the file, so that some fall on a rest


@dataclass(frozen=True)
class Lines:
    """Consecutive whole lines.

    data : bytes that end in a line feed, carriage returns removed
    first_line : number of the first line in the file, from 1
    note : what was lost at the end of these lines, or empty
    numbers : of each line in the file, where not all lines between are here
    tail : a last line without its end
    """

    data: bytes
    first_line: int
    note: str = ""
    numbers: tuple[int, ...] = ()
    tail: bytes = b""


def text_head(head: bytes) -> bytes:
    """The start of the text inside `head`, unpacked and as UTF-8; empty when it is not text."""
    if head.startswith(_GZIP):
        try:
            head = zlib.decompressobj(31).decompress(head, _HEAD)
        except zlib.error:
            return b""
    if head.startswith(_UTF16):
        head = head[: len(head) // 2 * 2].decode("utf-16", errors="replace").encode()
    head = head.removeprefix(codecs.BOM_UTF8)
    body = head.rstrip(b"\0")
    control = sum(body.count(c) for c in (b"\0", b"\x01", b"\x02", b"\x03", b"\x08", b"\x7f"))
    return b"" if control else clean(body)


def clean(data: bytes) -> bytes:
    """Line ends of Windows and of the old Mac as single line feeds."""
    if b"\r" not in data:
        return data
    return data.replace(b"\r\n", b"\n") if b"\n" in data else data.replace(b"\r", b"\n")


@contextmanager
def _opened(path: Path) -> Iterator[tuple[BinaryIO, bool]]:
    """The text bytes of the file, and whether it can be sought in cheaply."""
    with path.open("rb") as raw:
        start = raw.read(3)
        raw.seek(0)
        packed = start.startswith(_GZIP)
        stream = cast(BinaryIO, gzip.GzipFile(fileobj=raw)) if packed else cast(BinaryIO, raw)
        if packed:
            start = _peek(stream)
        if start.startswith(_UTF16):
            text = io.TextIOWrapper(stream, encoding="utf-16", errors="replace", newline="")
            yield cast(BinaryIO, _Utf8(text)), False
            return
        if start.startswith(codecs.BOM_UTF8):
            stream.seek(3)
        yield stream, not packed


def _peek(stream: BinaryIO) -> bytes:
    try:
        start = stream.read(3)
        stream.seek(0)
    except (EOFError, zlib.error, gzip.BadGzipFile):
        return b""
    return start


class _Utf8:
    """A text stream read as UTF-8 bytes."""

    def __init__(self, text: io.TextIOWrapper) -> None:
        self._text = text

    def read(self, size: int) -> bytes:
        return self._text.read(size).encode()


def whole_text(path: Path) -> bytes:
    """All of a small text file, unpacked and as UTF-8, its line ends as line feeds."""
    with _opened(path) as (stream, _):
        pieces = _chunks(stream, path, _LONGEST_LINE, strict=True)
        return clean(b"".join(piece for piece, _ in pieces))


def looks(path: Path) -> list[bytes]:
    """Whole lines from the start, from places between, and from the end of the file, in order.

    The first piece starts with line 1. A small file gives one piece with all of it. Packed text
    is read through once, keeping every k-th piece, with k doubled whenever there are too many.
    """
    with _opened(path) as (stream, can_seek):
        if can_seek:
            pieces = _looks_by_seeking(stream, path.stat().st_size)
        else:
            pieces = _looks_in_passing(stream, path)
    return [piece for piece in map(clean, pieces) if piece]


def _looks_by_seeking(stream: BinaryIO, size: int) -> list[bytes]:
    if size <= _PIECE * 4:
        return [_whole_lines(stream.read(), first=True)]
    pieces = [_whole_lines(stream.read(_PIECE), first=True)]
    for k in range(1, _LOOKS):
        stream.seek(min(size - _PIECE, size * k // (_LOOKS - 1)))
        pieces.append(_whole_lines(stream.read(_PIECE), first=False))
    return pieces


def _looks_in_passing(stream: BinaryIO, path: Path) -> list[bytes]:
    kept: list[bytes] = []
    stride = 1
    for index, (piece, _) in enumerate(_chunks(stream, path, _PIECE, strict=False)):
        if index % stride == 0:
            kept.append(_whole_lines(piece, first=index == 0))
        if len(kept) > 4 * _LOOKS:
            kept, stride = kept[::2], stride * 2
    return kept


def _whole_lines(piece: bytes, *, first: bool) -> bytes:
    piece = piece.rstrip(b"\0")
    end = b"\n" if b"\n" in piece else b"\r"
    start = 0 if first else piece.find(end) + 1
    stop = piece.rfind(end) + 1
    return piece[start:stop] if stop > start else b""


def _chunks(
    stream: BinaryIO, path: Path, size: int, *, strict: bool
) -> Iterator[tuple[bytes, str]]:
    """Pieces of the stream and, with the last one, what broke it off."""
    read = getattr(stream, "read1", stream.read)  # what is unpacked before an error is kept
    held: list[bytes] = []
    while True:
        try:
            piece = read(size)
        except (EOFError, zlib.error, OSError) as error:
            what = f"the compressed data breaks off: {error}"
            if strict:
                raise UnreadableInput(what, where=str(path), remedy="copy it again") from error
            yield b"".join(held), what
            return
        held.append(piece)
        if not piece or sum(map(len, held)) >= size:
            whole, held = b"".join(held), []
            if whole:
                yield whole, ""
        if not piece:
            return


def line_blocks(path: Path, size: int, *, strict: bool) -> Iterator[Lines]:
    """All lines of the file in blocks of about `size` bytes.

    An unended last line may be a cut number, so it is left out with a note; so is a tail of zero
    bytes, which a file system leaves after a power failure. With `strict` packed data that
    breaks off raises UnreadableInput.
    """
    rest, line, end, zeros = b"", 1, b"", 0
    with _opened(path) as (stream, _):
        for piece, note in _chunks(stream, path, size, strict=strict):
            end = end or (b"\r" if b"\n" not in piece and b"\r" in piece[:-1] else b"\n")
            text = rest + piece
            cut = text.rfind(end) + 1
            block, rest = clean(text[:cut]), text[cut:]
            zeros = 0 if cut else zeros
            if len(rest) > _LONGEST_LINE:
                # One zero byte stays, so that what may follow does not complete a cut number.
                kept = rest.rstrip(b"\0")
                zeros += max(len(rest) - len(kept) - 1, 0)
                rest = rest[: len(kept) + 1]
                if len(kept) > max(size, _LONGEST_LINE):
                    raise UnreadableInput(
                        f"no line end within {len(kept)} bytes", where=f"{path}: line {line}"
                    )
            if block or note:
                yield Lines(block, line, note)
                # Several times as fast as bytes.count.
                line += int(np.count_nonzero(np.frombuffer(block, np.uint8) == ord("\n")))
    tail = rest.rstrip(b"\0")
    if tail:
        said = f"line {line} has no line end and may be cut: it was left out"
        yield Lines(b"", line, said, tail=clean(tail) if tail == rest else b"")
    elif rest:
        yield Lines(
            b"", line, f"{len(rest) + zeros} zero bytes at the end of the file were left out"
        )
