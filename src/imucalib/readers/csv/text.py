"""Text of a table: bytes (plain, gzip, UTF-16), whole lines, their dialect, rows by a value."""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import re
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np

from imucalib.errors import UnreadableInput
from imucalib.readers.columns import understand
from imucalib.readers.devices.catalogue import rows_of_heading
from imucalib.recording.mapping import FieldMapping
from imucalib.units import without_brackets

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


BLANK = {""} | set(
    str.split(
        "nan na n/a null none - -- #n/a ? inf -inf +inf #value! #ref! #div/0! #num! #name? #null!"
    )
)
_NUMBER = {
    ".": re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?"),
    ",": re.compile(r"[+-]?(\d+|\d*,\d+)([eE][+-]?\d+)?"),
}
_FEWEST = 20  # rows that show with how many decimals the last number is written
_DELIMITERS = (",", ";", "\t", "|", " ")
#: What some loggers write before the names of the columns.
_BEFORE_NAMES = re.compile(r"^\s*;\s*(headers\s*,)?\s*", re.IGNORECASE)
_COMMENT = re.compile(r"^\s*(#|//|%)+\s*")


@dataclass(frozen=True)
class Dialect:
    """Shape of the table.

    delimiter : one character; " " stands for any run of blanks
    names : column names, or () without a header; units are a part of the names
    width : cells in a row; data_line : number of the first row's line, from 1
    numeric : which columns hold numbers; preamble : the lines above the table
    example : the cells of a row that has as many as any
    decimals : of the last number of every row, where these are equally many, else -1
    """

    delimiter: str
    decimal: str
    names: tuple[str, ...]
    width: int
    data_line: int
    numeric: tuple[bool, ...]
    preamble: tuple[str, ...]
    example: tuple[str, ...] = ()
    decimals: int = -1

    def address(self, column: int) -> str:
        """The name of a column where no other has it, else its number from 1."""
        name = self.names[column] if self.names else ""
        return name if name and self.names.count(name) == 1 else str(column + 1)

    def is_whole(self, line: bytes) -> bool:
        """Whether a last line without its end is a row: of a number that is cut, decimals lack."""
        row = cells_of(decoded(line), self.delimiter)
        return len(row) == self.width and 0 < self.decimals == _decimals(row[-1], self.decimal)


def _decimals(cell: str, mark: str) -> int:
    """Digits behind the decimal mark of a plain number; 0 of another."""
    plain = is_number(cell, mark) and "e" not in cell.lower()
    return len(cell.partition(mark)[2]) if plain else 0


@dataclass(frozen=True)
class _Shape:
    """What separates the cells of a row, how many there are, and which are numbers."""

    delimiter: str
    decimal: str
    width: int
    numeric: tuple[bool, ...] = ()
    blank_tail: bool = False  # rows end in a delimiter

    def is_row(self, line: str) -> bool:
        row = cells_of(line, self.delimiter)
        if len(row) != self.width:
            return False
        used = [c for c, n in zip(row, self.numeric, strict=True) if n]
        good = [is_number(c, self.decimal) for c in used]
        return any(good) and all(g or is_blank(c) for g, c in zip(good, used, strict=True))


def cells_of(line: str, delimiter: str) -> list[str]:
    """The stripped cells of one line, quotes removed."""
    if '"' in line:
        blank = delimiter == " "
        rows = csv.reader([line], delimiter=delimiter, skipinitialspace=True)
        try:
            return [c.strip() for c in next(rows, []) if c or not blank]
        except csv.Error:
            return [line]
    return line.split() if delimiter == " " else [c.strip() for c in line.split(delimiter)]


def decoded(text: bytes) -> str:
    """Text of UTF-8, or else of Windows-1252, in which spreadsheets write a degree sign."""
    try:
        return text.decode("utf-8")
    except UnicodeDecodeError:
        return text.decode("cp1252", errors="replace")


def is_comment(line: str) -> bool:
    """Whether the line is a remark."""
    return _COMMENT.match(line) is not None


def is_number(cell: str, decimal: str = ".") -> bool:
    """Whether the cell is a decimal number with this decimal mark."""
    return _NUMBER[decimal].fullmatch(cell) is not None


def is_blank(cell: str) -> bool:
    """Whether the cell stands for a missing value."""
    return cell.lower() in BLANK


def sniff(looks: Sequence[bytes], mapping: FieldMapping, where: str) -> Dialect:
    """The dialect that explains the lines from all over the file best.

    The start alone misleads: it may be zeros, or a header. Raises UnreadableInput when no table
    of numbers is found.
    """
    pieces = [decoded(piece).split("\n")[:-1] for piece in looks]
    body = _body(pieces, mapping.skip or 0)
    delimiters = (mapping.delimiter,) if mapping.delimiter else _DELIMITERS
    marks = (mapping.decimal,) if mapping.decimal else (".", ",")
    quoted = any('"' in line for line in body)
    best, best_score = _Shape("", "", 0), 0
    for delimiter in delimiters:
        rows = [cells_of(line, delimiter) for line in body]
        for mark in marks:
            if mark == delimiter and not quoted:
                continue
            score, width = _score(rows, mark)
            if score > best_score:
                best, best_score = _Shape(delimiter, mark, width), score
    if not best_score:
        raise UnreadableInput(
            "no table of numbers was found in the text",
            where=where,
            remedy="give --skip, --delimiter and --decimal if the file holds one",
        )
    rows = [r for r in (cells_of(line, best.delimiter) for line in body) if len(r) == best.width]
    numeric, tail = _numeric_columns(rows, best), all(not r[-1] for r in rows)
    shape = replace(best, numeric=numeric, blank_tail=tail)
    example = max(rows, key=lambda row: sum(not is_blank(cell) for cell in row))
    last = {_decimals(row[-1], best.decimal) for row in rows}
    decimals = last.pop() if len(last) == 1 and len(rows) >= _FEWEST else -1
    found = _with_header(shape, pieces[0], mapping, where)
    return replace(found, example=tuple(example), decimals=decimals)


def _body(pieces: list[list[str]], skip: int) -> list[str]:
    """Lines that are surely data, if the file has any: from the middle of each piece."""
    lines = [line for line in pieces[0][skip:] if line.strip()] if pieces else []
    chosen = lines[len(lines) // 2 :][:200]
    for piece in pieces[1:]:
        inner = [line for line in piece if line.strip()]
        chosen += inner[len(inner) // 2 :][:20]
    return chosen


def _score(rows: list[list[str]], mark: str) -> tuple[int, int]:
    """Numeric cells in the rows of the commonest width, and that width."""
    counts: Counter[int] = Counter()
    for row in rows:
        counts[len(row)] += sum(is_number(c, mark) for c in row)
    width, score = max(counts.items(), key=lambda kv: kv[1], default=(0, 0))
    return score, width


def _numeric_columns(rows: list[list[str]], shape: _Shape) -> tuple[bool, ...]:
    numeric = []
    for c in range(shape.width):
        numbers = sum(is_number(r[c], shape.decimal) for r in rows)
        blanks = sum(is_blank(r[c]) for r in rows)
        numeric.append(numbers > 0 and numbers + blanks > 0.5 * len(rows))
    return tuple(numeric)


def _with_header(shape: _Shape, lines: list[str], mapping: FieldMapping, where: str) -> Dialect:
    start = mapping.skip or 0
    first = start + (1 if mapping.header else 0)
    while first < len(lines) and not shape.is_row(lines[first]):
        first += 1
    if first >= len(lines):
        raise UnreadableInput(
            "no data row was found near the start",
            where=where,
            remedy="give --skip, the lines before the heading, where the table comes later",
        )
    rows = 0 if mapping.skip is not None or mapping.header else rows_of_heading(lines[first:])
    first += rows
    above = [k for k in range(start, first) if lines[k].strip()]
    # A heading that is repeated behind the zero bytes of a power failure is the one above.
    whole = {lines[k] for k in above}
    above = [k for k in above if "\0" not in lines[k] or lines[k].strip("\0") not in whole]
    names = () if mapping.header is False else _names(lines, above, shape)
    if mapping.skip is None and not rows:
        while above and not mapping.header and _is_damaged_row(lines[above[-1]], shape):
            first = above.pop()
        names = () if mapping.header is False else _names(lines, above, shape)
    if any(c < " " for name in names for c in name):
        raise UnreadableInput(
            "the heading is damaged: it holds control characters",
            where=f"{where}: line {above[-1] + 1}",
            remedy="copy the file again, or correct that line",
        )
    preamble = tuple(lines[:first])
    return Dialect(
        delimiter=shape.delimiter,
        decimal=shape.decimal,
        names=names,
        width=shape.width,
        data_line=first + 1,
        numeric=shape.numeric,
        preamble=preamble,
    )


def _is_damaged_row(line: str, shape: _Shape) -> bool:
    """Whether a line above the table is mostly numbers: a damaged row, no header."""
    row = cells_of(line, shape.delimiter)
    if len(row) != shape.width:
        good = sum(is_number(c, shape.decimal) for c in row)
        return len(row) >= max(2, shape.width - 1) and 2 * good > len(row)
    good = sum(is_number(c, shape.decimal) for c, n in zip(row, shape.numeric, strict=True) if n)
    return 2 * good > sum(shape.numeric)


def _names(lines: list[str], above: list[int], shape: _Shape) -> tuple[str, ...]:
    """Column names from the last line above the table, or the last but one with units below."""
    found = [_split_names(lines[k], shape) for k in above[-2:]]
    if not found or not found[-1]:
        return ()
    names = found[-1]
    understood = any(c.quantity for c in understand(names))
    if len(found) == 2 and found[0] and not understood:
        upper = found[0]
        if any(c.quantity for c in understand(upper)):
            pairs = zip(upper, names, strict=True)
            return tuple(f"{n} [{without_brackets(u)}]" if u else n for n, u in pairs)
    return names


def _split_names(line: str, shape: _Shape) -> tuple[str, ...]:
    bare, width = _COMMENT.sub("", line), shape.width
    for candidate in (shape.delimiter, ",", ";", "\t", " "):
        names = cells_of(bare if candidate == ";" else _BEFORE_NAMES.sub("", bare), candidate)
        if len(names) == width + 1 and not names[-1]:
            names = names[:-1]
        merged = any(candidate in n or '"' in n for n in names)  # a lost quote joins two names
        if len(names) == width - 1 and shape.blank_tail and not merged:
            names = [*names, ""]
        if len(names) == width and sum(any(ch.isalpha() for ch in n) for n in names) * 2 >= width:
            return tuple(names)
    return ()


#: Values that a column may take to be told: more are no sensors, tools or sessions of one file.
_FEW = 12
#: Words of headings whose numbers are names.
_NAMES = {"serial", "id", "tool", "device", "sensor", "subject", "tag", "session", "tagid"}


@dataclass(frozen=True)
class Condition:
    """column : from 0; value : as it stands in the cells, or another spelling of the number"""

    column: int
    value: str

    def fits(self, cell: str) -> bool:
        """Whether a cell holds the value."""
        if cell == self.value:
            return True
        return is_number(cell) and is_number(self.value) and float(cell) == float(self.value)


def parted(condition: str) -> tuple[str, str]:
    """Column and value of "serial=A12"."""
    column, _, value = condition.partition("=")
    return column.strip(), value.strip()


def demand_some(
    kept: int, conditions: Sequence[str], cells: Sequence[Sequence[str]], where: str
) -> None:
    """Raise UnreadableInput where no row is left. cells : of each condition's column"""
    if kept:
        return
    there = [
        f"{parted(c)[0]} is {_listed(Counter(v))}" for c, v in zip(conditions, cells, strict=True)
    ]
    raise UnreadableInput(
        f"no row has {' and '.join(conditions)}",
        where=where,
        remedy=f"choose what is there with --where: {'; '.join(there)}",
    )


def told(name: str, cells: Sequence[str]) -> str:
    """What is said of a column that takes a few values of words or names, or ""."""
    found = Counter(cell for cell in cells if cell)
    words = not all(is_number(cell) for cell in found)
    named = bool(set(name.lower().replace("-", "_").replace(" ", "_").split("_")) & _NAMES)
    if not 2 <= len(found) <= _FEW or not (words or named):
        return ""
    first = next(iter(found))
    return f"column '{name}' is {_listed(found)} (--where '{name}={first}' reads those rows alone)"


def _listed(found: Counter[str]) -> str:
    """Values and how often they occur."""
    shown = ", ".join(f"{value or 'empty'} ({n} rows)" for value, n in list(found.items())[:_FEW])
    return shown + (", ..." if len(found) > _FEW else "")
