"""Whole blocks of rows to numbers: by numpy's C parser where all are plain, else row by row."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers.csv.dialect import Dialect
from imucalib.readers.csv.stamps import MISSING
from imucalib.readers.csv.text import Lines, count_of, is_blank, is_number

_COMMA_TO_POINT = bytes.maketrans(b",", b".")
_INTEGER = re.compile(r"[+-]?\d{1,18}(\.0*)?|[+-]?\d{19}")


@dataclass(frozen=True)
class TableLayout:
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
class ParsedRows:
    """Parsed rows: stamps (n,) int64 (MISSING where blank), float64 or bytes; values (n, m).

    bad : why rows were left out; lines : (n,) line of each row, None when they follow each other
    """

    stamps: NDArray[np.generic]
    values: Array
    bad: tuple[UnreadableInput, ...] = ()
    lines: NDArray[np.intp] | None = None

    def at(self, keep: NDArray[np.bool_]) -> ParsedRows:
        """Some of the rows."""
        stamps = self.stamps[keep] if self.stamps.size else self.stamps
        lines = None if self.lines is None else self.lines[keep]
        return ParsedRows(stamps, self.values[keep], self.bad, lines)


def parse(lines: Lines, layout: TableLayout, where: str) -> ParsedRows:
    """Parse a block of whole lines; blank cells become NaN, and so do infinite values.

    Blank lines are dropped in a file with time stamps and mean a missing row otherwise; so are
    bad ones, which `Rows.bad` names. Raises UnreadableInput when more than half of them are bad.
    """
    text, dialect = lines.data.replace(b'"', b""), layout.dialect
    plain = dialect.decimal != dialect.delimiter
    if dialect.decimal == "," and plain:
        text = text.translate(_COMMA_TO_POINT)
    rows = _plain(text, layout) if plain else None
    if rows is None and plain and dialect.delimiter != " ":
        rows = _plain(_fill(text, dialect.delimiter.encode()), layout)
    if rows is None:
        rows = _by_lines(lines, layout, where)
    elif lines.numbers:
        rows = replace(rows, lines=np.array(lines.numbers, dtype=np.intp))
    finite = np.isfinite(rows.values)
    return rows if finite.all() else replace(rows, values=np.where(finite, rows.values, np.nan))


def _fill(text: bytes, mark: bytes) -> bytes:
    """The text with nan in its empty cells."""
    text = b"\n" + text
    for _ in range(2):
        text = text.replace(mark + mark, mark + b"nan" + mark)
    return text.replace(mark + b"\n", mark + b"nan\n").replace(b"\n" + mark, b"\nnan" + mark)[1:]


def _plain(text: bytes, layout: TableLayout) -> ParsedRows | None:
    """The rows if every line has all its cells and all wanted cells are numbers."""
    count, delimiter = count_of(text, b"\n"), layout.dialect.delimiter
    dtype = np.dtype(
        [("t", _type_of(layout), (len(layout.time),)), ("v", "f8", (len(layout.values),))]
    )
    if not count or not _complete(text, delimiter, layout.dialect.width, count):
        return None
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
    stamps = table["t"]
    if stamps.shape[1] > 1:
        stamps = _join(stamps)
    return ParsedRows(np.ascontiguousarray(stamps.reshape(-1)), np.ascontiguousarray(table["v"]))


def _type_of(layout: TableLayout) -> str:
    return {"int": "i8", "float": "f8", "text": f"S{layout.text_width}", "": "i8"}[layout.kind]


def _join(texts: NDArray[np.bytes_]) -> NDArray[np.bytes_]:
    """Stamps whose parts (n, k) are in several columns; blank where a part is."""
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


def _by_lines(lines: Lines, layout: TableLayout, where: str) -> ParsedRows:
    """The rows that are good, and what is wrong with the others."""
    stamps, values, numbers = list[float | bytes](), list[list[float]](), list[int]()
    bad: list[UnreadableInput] = []
    texts = lines.data.split(b"\n")[:-1]
    every = lines.numbers or range(lines.first_line, lines.first_line + len(texts))
    for number, line in zip(every, texts, strict=True):
        row = layout.dialect.cells(line.decode("utf-8", errors="replace"))
        blank = not line.strip()
        wrong = None if blank else _wrong(row, layout)
        if wrong:
            what, column = wrong
            at = f"{where}: line {number}" + (f", column {column + 1}" if column >= 0 else "")
            bad.append(UnreadableInput(what, where=at, remedy="correct or delete that line"))
        if wrong or blank:
            if layout.time:
                continue
            row = [""] * layout.dialect.width
        numbers.append(number)
        values.append([_number(row[k], layout) for k in layout.values])
        stamps.append(_stamp([row[k] for k in layout.time], layout))
    if 2 * len(bad) > len(numbers) + len(bad):
        raise bad[0]
    return ParsedRows(
        np.array(stamps if layout.time else [], dtype=_type_of(layout)),
        np.array(values, dtype=np.float64).reshape(len(values), len(layout.values)),
        tuple(bad),
        np.array(numbers, dtype=np.intp),
    )


def _number(cell: str, layout: TableLayout) -> float:
    return np.nan if is_blank(cell) else float(cell.replace(layout.dialect.decimal, "."))


def _stamp(cells: Sequence[str], layout: TableLayout) -> float | bytes:
    if layout.kind == "text":
        return b"" if any(map(is_blank, cells)) else " ".join(cells).encode()
    if layout.kind == "int":
        return MISSING if is_blank(cells[0]) else int(cells[0].partition(".")[0])
    return _number(cells[0], layout) if cells else 0.0


def _wrong(row: Sequence[str], layout: TableLayout) -> tuple[str, int] | None:
    """What is wrong with a row, and in which column (-1: in all)."""
    if len(row) != layout.dialect.width:
        return f"{len(row)} cells where the other rows have {layout.dialect.width}", -1
    stamps = layout.time if layout.kind in ("int", "float") else ()
    for column in (*stamps, *layout.values):
        cell = row[column]
        integer = column in stamps and layout.kind == "int"
        bad = not is_number(cell, layout.dialect.decimal)
        bad = bad or (integer and not (_INTEGER.fullmatch(cell) and abs(float(cell)) < 2.0**63))
        if bad and not is_blank(cell):
            return f"'{cell[:40]}' is not {'an integer' if integer else 'a number'}", column
    return None
