"""Text of a table: bytes (plain, gzip, UTF-16), whole lines of them, and the cells of a line."""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import re
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO

import numpy as np

from imucalib.errors import UnreadableInput
from imucalib.question import paste

_GZIP = b"\x1f\x8b"
_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_PIECE = 1 << 16  # bytes of one look
_LONGEST_LINE = 1 << 20
_HEAD = 1 << 18  # unpacked bytes of the first look
_LOOKS = 24  # looks spread over the file, so that some fall on a rest
_CONTROL = (b"\0", b"\x01", b"\x02", b"\x03", b"\x08", b"\x7f")  # in no text
BLANK = {""} | set(
    str.split(
        "nan na n/a null none - -- #n/a ? inf -inf +inf #value! #ref! #div/0! #num! #name? #null!"
    )
)
_NUMBER = {
    ".": re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?"),
    ",": re.compile(r"[+-]?(\d+|\d*,\d+)([eE][+-]?\d+)?"),
}
COMMENT = re.compile(r"^\s*(#|//|%)+\s*")  #: what begins a remark
#: Values that a column may take to be named: more are no sensors, tools or sessions of one file.
_FEW = 12
#: Words of headings whose numbers are names.
_NAMES = {"serial", "id", "tool", "device", "sensor", "subject", "tag", "session", "tagid"}


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

    def from_line(self, number: int) -> Lines:
        """The lines from one of the file's on, which all may be already."""
        above = number - self.first_line
        if above <= 0:
            return self
        parts = self.data.split(b"\n", above)
        return replace(self, data=parts[-1] if len(parts) > above else b"", first_line=number)


def text_head(head: bytes) -> bytes:
    """The start of the text inside `head`, unpacked and as UTF-8; empty when it is not text."""
    if head.startswith(_GZIP):
        try:
            head = zlib.decompressobj(31).decompress(head, _HEAD)
        except zlib.error:
            return b""
    if head.startswith(_UTF16):
        head = head[: len(head) // 2 * 2].decode("utf-16", errors="replace").encode()
    body = head.removeprefix(codecs.BOM_UTF8).rstrip(b"\0")
    return b"" if any(c in body for c in _CONTROL) else _clean(body)


def _clean(data: bytes) -> bytes:
    """Line ends of Windows and of the old Mac as single line feeds."""
    if b"\r" not in data:
        return data
    return data.replace(b"\r\n", b"\n") if b"\n" in data else data.replace(b"\r", b"\n")


@contextmanager
def _open(path: Path) -> Iterator[tuple[Callable[[int], bytes], BinaryIO | None]]:
    """What reads bytes of the text, and the file itself where it can be sought in cheaply."""
    with path.open("rb") as raw:
        packed = raw.peek(2).startswith(_GZIP)
        stream = gzip.GzipFile(fileobj=raw) if packed else raw
        try:
            start = stream.peek(3)
        except (EOFError, zlib.error, gzip.BadGzipFile):
            start = b""
        if start.startswith(_UTF16):
            text = io.TextIOWrapper(stream, encoding="utf-16", errors="replace", newline="")
            yield lambda size: text.read(size).encode(), None
            return
        if start.startswith(codecs.BOM_UTF8):
            stream.seek(3)
        # What is unpacked before an error is kept by read1.
        yield stream.read1, None if packed else raw


def whole_text(path: Path, most: int = 0) -> bytes:
    """All of a small text file, unpacked and as UTF-8, its line ends as line feeds; most : of a
    large one, lines after which it may end, at the end of one."""
    held = list[bytes]()
    with _open(path) as (read, _):
        for piece, _ in _chunks(read, path, _LONGEST_LINE, strict=True):
            held.append(piece)
            if most and sum(part.count(b"\n") for part in held) > most:
                held[-1] = piece[: piece.rfind(b"\n") + 1]
                break
    return _clean(b"".join(held))


def looks(path: Path) -> list[bytes]:
    """Whole lines from the start, from places between, and from the end of the file, in order.

    The first piece starts with line 1. A small file gives one piece with all of it. Packed text
    is read through once, keeping every k-th piece, with k doubled whenever there are too many.
    """
    pieces: list[bytes] = []
    with _open(path) as (read, file):
        size = path.stat().st_size
        if file is None:
            stride = 1
            for index, (piece, _) in enumerate(_chunks(read, path, _PIECE, strict=False)):
                if index % stride == 0:
                    pieces.append(_whole_lines(piece, first=index == 0))
                if len(pieces) > 4 * _LOOKS:
                    pieces, stride = pieces[::2], stride * 2
        elif size <= _PIECE * 4:
            pieces = [_whole_lines(file.read(), first=True)]
        else:
            pieces = [_whole_lines(file.read(_PIECE), first=True)]
            for k in range(1, _LOOKS):
                file.seek(min(size - _PIECE, size * k // (_LOOKS - 1)))
                pieces.append(_whole_lines(file.read(_PIECE), first=False))
    return [piece for piece in map(_clean, pieces) if piece]


def _whole_lines(piece: bytes, *, first: bool) -> bytes:
    piece = piece.rstrip(b"\0")
    end = b"\n" if b"\n" in piece else b"\r"
    start = 0 if first else piece.find(end) + 1
    stop = piece.rfind(end) + 1
    return piece[start:stop] if stop > start else b""


def _chunks(
    read: Callable[[int], bytes], path: Path, size: int, *, strict: bool
) -> Iterator[tuple[bytes, str]]:
    """Pieces of the text and, with the last one, what broke it off."""
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
    with _open(path) as (read, _):
        for piece, note in _chunks(read, path, size, strict=strict):
            end = end or (b"\r" if b"\n" not in piece and b"\r" in piece[:-1] else b"\n")
            text = rest + piece
            cut = text.rfind(end) + 1
            block, rest = _clean(text[:cut]), text[cut:]
            zeros = 0 if cut else zeros
            if len(rest) > _LONGEST_LINE:
                # One zero byte stays, so that what may follow does not complete a cut number.
                kept = rest.rstrip(b"\0")
                zeros += max(len(rest) - len(kept) - 1, 0)
                rest = rest[: len(kept) + 1]
                if len(kept) > max(size, _LONGEST_LINE):
                    what = f"no line end within {len(kept)} bytes"
                    raise UnreadableInput(what, where=f"{path}: line {line}")
            if block or note:
                yield Lines(block, line, note)
                line += count_of(block, b"\n")
    tail = rest.rstrip(b"\0")
    if tail:
        note = f"line {line} has no line end and may be cut: it was left out"
        yield Lines(b"", line, note, tail=_clean(tail) if tail == rest else b"")
    elif rest:
        note = f"{len(rest) + zeros} zero bytes at the end of the file were left out"
        yield Lines(b"", line, note)


def count_of(text: bytes, byte: bytes) -> int:
    """How often a byte occurs: several times as fast as bytes.count."""
    return int(np.count_nonzero(np.frombuffer(text, np.uint8) == ord(byte)))


def cells_of(line: str, delimiter: str) -> list[str]:
    """The stripped cells of one line, quotes removed; the delimiter " " is any run of blanks."""
    if '"' in line:
        blank = delimiter == " "
        rows = csv.reader([line], delimiter=delimiter, skipinitialspace=True)
        try:
            return [c.strip() for c in next(rows, []) if c or not blank]
        except csv.Error:
            return [line]
    return line.split() if delimiter == " " else [c.strip() for c in line.split(delimiter)]


def decode_text(text: bytes) -> str:
    """Text of UTF-8, or else of Windows-1252, in which spreadsheets write a degree sign."""
    try:
        return text.decode("utf-8")
    except UnicodeDecodeError:
        return text.decode("cp1252", errors="replace")


def is_number(cell: str, decimal: str = ".") -> bool:
    """Whether the cell is a decimal number with this decimal mark."""
    return _NUMBER[decimal].fullmatch(cell) is not None


def is_blank(cell: str) -> bool:
    """Whether the cell stands for a missing value."""
    return cell.lower() in BLANK


@dataclass(frozen=True)
class Condition:
    """One "serial=A12" of `--where`.

    name : of the column; value : as it is in the cells, or another spelling of the number
    """

    name: str
    value: str

    @classmethod
    def of(cls, text: str) -> Condition:
        """The condition that a text states."""
        name, _, value = text.partition("=")
        return cls(name.strip(), value.strip())

    def fits(self, cell: str) -> bool:
        """Whether a cell holds the value."""
        if cell == self.value:
            return True
        return is_number(cell) and is_number(self.value) and float(cell) == float(self.value)


def no_row_has(
    conditions: Sequence[str], cells: Sequence[Sequence[str]], where: str
) -> UnreadableInput:
    """The error where no row is left. cells : of each condition's column"""
    pairs = zip(conditions, cells, strict=True)
    there = [f"{Condition.of(text).name} is {_listed(v)}" for text, v in pairs]
    return UnreadableInput(
        f"no row has {' and '.join(conditions)}",
        where=where,
        remedy=f"choose what is there with --where: {'; '.join(there)}",
    )


def few_values(name: str, cells: Sequence[str], decimal: str = ".") -> str:
    """A sentence on a column that takes a few values of words or names, or ""; decimal : mark of
    its numbers"""
    found = list(dict.fromkeys(cell for cell in cells if cell))
    words = not all(is_number(cell.replace(decimal, ".")) for cell in found)
    named = bool(set(name.lower().replace("-", "_").replace(" ", "_").split("_")) & _NAMES)
    if not 2 <= len(found) <= _FEW or not (words or named):
        return ""
    option = paste("--where", f"{name}={found[0]}")
    return f"column '{name}' is {_listed(found)} ({option} reads those rows alone)"


def take_turns(name: str, cells: Sequence[str], decimal: str = ".") -> bool:
    """Whether rows of several devices take turns, by a column of their words or numbers."""
    turns = sum(one != other for one, other in pairwise(cells))
    return 2 * turns > len(cells) and bool(few_values(name, cells, decimal))


def _listed(cells: Sequence[str]) -> str:
    """Values, not how often they occur: of a long file only pieces are looked at."""
    found = list(dict.fromkeys(cells))
    shown = ", ".join(value or "empty" for value in found[:_FEW])
    return shown + (", ..." if len(found) > _FEW else "")
