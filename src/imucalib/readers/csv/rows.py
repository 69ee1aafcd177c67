"""Whole blocks of rows to numbers, by numpy's C parser; row by row to name a bad cell."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers.csv.dialect import Dialect
from imucalib.readers.csv.stamps import MISSING
from imucalib.readers.csv.text import Lines, cells_of, count_of, is_blank, is_number

_COMMA_TO_POINT = bytes.maketrans(b",", b".")
_ERRORS = rb"#(?:value|ref|div/0|num|null)!|#name\?"  # of a spreadsheet
_MISSING = re.compile(
    rb"(?i)(?<=[,;\t| \n])(?:na|n/a|#n/a|null|none|--?|\?|" + _ERRORS + rb")(?=[,;\t| \n])"
)
_LARGEST_EXACT = 2.0**53
_INTEGER = re.compile(r"[+-]?\d{1,18}(\.0*)?|[+-]?\d{19}")


@dataclass(frozen=True)
class Layout:
    """Which columns to read, and how.

    time : columns of the stamps, several of "text" only, or none
    kind : of the stamps, "int", "float", "text" or ""
    values : columns of the numbers, in the order of the output
    text_width : bytes kept of a text stamp
    """

    dialect: Dialect
    time: tuple[int, ...]
    kind: str
    values: tuple[int, ...]
    text_width: int = 32


@dataclass(frozen=True)
class Rows:
    """Parsed rows: stamps (n,) int64 (MISSING where blank), float64 or bytes; values (n, m).

    bad : why rows were left out; lines : (n,) line of each row, None when they follow each other
    """

    stamps: NDArray[np.generic]
    values: Array
    bad: tuple[UnreadableInput, ...] = ()
    lines: NDArray[np.intp] | None = None

    def at(self, keep: NDArray[np.bool_]) -> Rows:
        """Some of the rows."""
        stamps = self.stamps[keep] if self.stamps.size else self.stamps
        lines = None if self.lines is None else self.lines[keep]
        return Rows(stamps, self.values[keep], self.bad, lines)


def parse(lines: Lines, layout: Layout, where: str) -> Rows:
    """Parse a block of whole lines; blank cells become NaN.

    Blank lines are dropped in a file with time stamps and mean a missing row otherwise; so are
    bad ones, which `Rows.bad` names. Raises UnreadableInput when more than half of them are bad.
    """
    rows, numbers, bad = _whole(lines.data, layout), lines.numbers, list[UnreadableInput]()
    if rows is None:
        text, numbers, bad = _good_lines(lines, layout, where)
        rows = _whole(text, layout)
        if rows is None or 2 * len(bad) > len(numbers) + len(bad):
            last = lines.first_line + lines.data.count(b"\n")
            span = f"{where}: lines {lines.first_line} to {last}"
            what, remedy = "a row cannot be read", "look for odd characters"
            raise bad[0] if bad else UnreadableInput(what, where=span, remedy=remedy)
    at = np.array(numbers, dtype=np.intp)
    fits = at.size == rows.values.shape[0] and (at.size or bad)
    return replace(rows, bad=tuple(bad), lines=at if fits else None)


def _whole(text: bytes, layout: Layout) -> Rows | None:
    """The rows, if every line is one."""
    delimiter = layout.dialect.delimiter
    if b'"' in text:
        text, delimiter = _unquoted(text, layout.dialect)
    if layout.dialect.decimal == ",":
        text = text.translate(_COMMA_TO_POINT)
    rows = _attempt(text, delimiter, layout, layout.kind)
    if rows is not None:
        return rows
    text = _completed(text, delimiter, layout)
    if layout.kind != "int":
        return _attempt(text, delimiter, layout, layout.kind)
    rows = _attempt(text, delimiter, layout, "text")
    stamps = None if rows is None else _integers(rows.stamps)
    return None if rows is None or stamps is None else replace(rows, stamps=stamps)


def _attempt(text: bytes, delimiter: str, layout: Layout, kind: str) -> Rows | None:
    """The C parser's result if every line has all its cells and all wanted cells are numbers."""
    count = count_of(text, b"\n")
    if not _complete(text, delimiter, layout.dialect.width, count):
        return None
    of_kind = {"int": "i8", "float": "f8", "text": f"S{layout.text_width}", "": "i8"}[kind]
    dtype = np.dtype([("t", of_kind, (len(layout.time),)), ("v", "f8", (len(layout.values),))])
    if count == 0:
        return Rows(np.empty(0, dtype=of_kind), np.empty((0, len(layout.values))))
    try:
        table = np.loadtxt(
            io.BytesIO(text),
            dtype=dtype,
            delimiter=None if delimiter == " " else delimiter,
            usecols=[*layout.time, *layout.values],
            comments=None,
            ndmin=1,
        )
    except (ValueError, OverflowError):
        return None
    if table.size != count:
        return None
    values: Array = table["v"].reshape(count, len(layout.values))
    finite = np.isfinite(values)
    return Rows(_joined(table["t"]), values if finite.all() else np.where(finite, values, np.nan))


def _joined(parts: NDArray[np.generic]) -> NDArray[np.generic]:
    """Stamps (n,) of one column, or of the parts (n, k) in several; blank where a part is."""
    if parts.shape[1] < 2:
        return np.ascontiguousarray(parts.reshape(-1))
    texts = parts.astype(np.bytes_)
    whole = texts[:, 0]
    for part in texts.T[1:]:
        whole = np.char.add(np.char.add(whole, b" "), part)
    whole[np.isin(texts, [b"", b"nan", b"NaN"]).any(axis=1)] = b""
    return whole


def _complete(text: bytes, delimiter: str, width: int, count: int) -> bool:
    if delimiter != " ":
        return count_of(text, delimiter.encode()) == count * (width - 1)
    inside = np.frombuffer(text, dtype=np.uint8) > 32
    starts = int(np.count_nonzero(inside[1:] & ~inside[:-1])) + int(inside[:1].any())
    return starts == count * width


def _unquoted(text: bytes, dialect: Dialect) -> tuple[bytes, str]:
    """The text without quotes, and its delimiter (a quoted cell may hold the original one)."""
    count, bare, delimiter = text.count(b"\n"), text.replace(b'"', b""), dialect.delimiter
    if dialect.decimal != delimiter and _complete(bare, delimiter, dialect.width, count):
        return bare, delimiter
    rows = csv.reader(io.StringIO(text.decode("utf-8", errors="replace")), delimiter=delimiter)
    try:
        out = "".join("\t".join(c.strip() for c in row) + "\n" for row in rows)
    except csv.Error:
        return bare, delimiter
    return out.encode(), "\t"


def _completed(text: bytes, delimiter: str, layout: Layout) -> bytes:
    """Blank cells and the words for missing values as nan; blank lines dropped or all nan."""
    missing = b"" if layout.time else _missing_row(delimiter, layout.dialect.width) + b"\n"
    if delimiter == " ":
        return _MISSING.sub(b"nan", re.sub(rb"(?m)^[ \t]*\n", missing, text))
    mark = delimiter.encode()
    text = b"\n" + re.sub(rb"(?m)^[ ]*\n", missing, text)
    text = re.sub(rb"[ ]*(" + re.escape(mark) + rb"|\n)[ ]*", rb"\1", text)
    text = _MISSING.sub(b"nan", text)
    for _ in range(2):
        text = text.replace(mark + mark, mark + b"nan" + mark)
    text = text.replace(mark + b"\n", mark + b"nan\n").replace(b"\n" + mark, b"\nnan" + mark)
    return text[1:]


def _missing_row(delimiter: str, width: int) -> bytes:
    """A row without any value."""
    return b" ".join([b"nan"] * width) if delimiter == " " else delimiter.encode() * (width - 1)


def _integers(stamps: NDArray[np.generic]) -> NDArray[np.int64] | None:
    """Stamps as text, whole numbers all of them; MISSING where blank."""
    texts = np.char.strip(stamps.astype(np.bytes_))
    blank = np.isin(texts, [b"nan", b"NaN", b""])
    out = np.full(texts.shape, MISSING, dtype=np.int64)
    try:
        out[~blank] = [_integer(text) for text in texts[~blank].tolist()]
    except (ValueError, OverflowError):
        return None
    return out


def _integer(text: bytes) -> int:
    try:
        return int(text)
    except ValueError:
        number = float(text)
        if not number.is_integer() or abs(number) >= _LARGEST_EXACT:
            raise
        return int(number)


def _good_lines(
    lines: Lines, layout: Layout, where: str
) -> tuple[bytes, tuple[int, ...], list[UnreadableInput]]:
    """The lines without the bad ones, their numbers, and what is wrong with the others."""
    kept, numbers, bad = list[bytes](), list[int](), list[UnreadableInput]()
    missing = _missing_row(layout.dialect.delimiter, layout.dialect.width)
    texts = lines.data.split(b"\n")[:-1]
    every = lines.numbers or range(lines.first_line, lines.first_line + len(texts))
    for number, line in zip(every, texts, strict=True):
        wrong = line.strip() and _wrong(line.decode("utf-8", errors="replace"), layout)
        if wrong:
            what, column = wrong
            at = f"{where}: line {number}" + (f", column {column + 1}" if column >= 0 else "")
            bad.append(UnreadableInput(what, where=at, remedy="correct or delete that line"))
        if layout.time and (wrong or not line.strip()):
            continue
        kept.append((missing if wrong else line) + b"\n")
        numbers.append(number)
    return b"".join(kept), tuple(numbers), bad


def _wrong(line: str, layout: Layout) -> tuple[str, int] | None:
    """What is wrong with a row, and in which column (-1: in all)."""
    row = cells_of(line, layout.dialect.delimiter)
    if len(row) != layout.dialect.width:
        return f"{len(row)} cells where the other rows have {layout.dialect.width}", -1
    stamps = layout.time if layout.kind in ("int", "float") else ()
    for column in (*stamps, *layout.values):
        cell = row[column]
        integer = column in stamps and layout.kind == "int"
        bad = not is_number(cell, layout.dialect.decimal)
        if (bad or (integer and not _INTEGER.fullmatch(cell))) and not is_blank(cell):
            return f"'{cell[:40]}' is not {'an integer' if integer else 'a number'}", column
    return None
