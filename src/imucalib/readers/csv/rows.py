"""Whole blocks of rows to numbers, by numpy's C parser or pyarrow's; row by row to name a bad cell.

pyarrow's is two to three times as fast. It is optional, so its numbers must be numpy's to the last
bit: both round correctly. Where the two could differ in what they accept, numpy's parser decides.
"""

from __future__ import annotations

import csv
import importlib.util
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers.csv.stamps import MISSING
from imucalib.readers.csv.text import Lines, cells_of, is_blank, is_number


@cache
def arrow_is_installed() -> bool:
    """Whether pyarrow is installed."""
    return importlib.util.find_spec("pyarrow") is not None


def columns_of(
    text: bytes,
    delimiter: str,
    width: int,
    stamps: tuple[tuple[int, ...], str] | None,
    values: Sequence[int],
) -> tuple[list[NDArray[np.generic]], Array] | None:
    """Stamps (n,) of each of their columns and values (n, m) of whole lines of `width` cells.

    stamps : their columns and kind ("int", "float" or "text"), or None: there are none then
    None comes back when anything in the columns is not plainly of its kind, and for stamps as text
    of differing length.
    """
    # pyarrow reads hexadecimal integers, and takes a carriage return for the end of a line.
    if delimiter == " " or not text or any(code in text for code in (b"x", b"X", b"\r")):
        return None
    import pyarrow as pa

    of_kind = {"int": pa.int64(), "float": pa.float64(), "text": pa.binary()}
    kinds = {str(k): pa.float64() for k in values}
    if stamps is not None:
        kinds |= {str(k): of_kind[stamps[1]] for k in stamps[0]}
    table = _table(text, delimiter, width, kinds)
    if table is None or any(table.column(name).null_count for name in kinds):
        return None
    found = np.empty((table.num_rows, len(values)))
    for at, k in enumerate(values):
        found[:, at] = table.column(str(k)).to_numpy()
    times = []
    for k in stamps[0] if stamps else ():
        column = table.column(str(k)).combine_chunks()
        part = _texts(column) if stamps and stamps[1] == "text" else column.to_numpy()
        if part is None:
            return None
        times.append(part)
    return times, found


def _table(text: bytes, delimiter: str, width: int, kinds: dict[str, Any]) -> Any:
    import pyarrow as pa
    from pyarrow import csv

    names = [str(k) for k in range(width)]
    try:
        return csv.read_csv(
            pa.py_buffer(text),
            csv.ReadOptions(use_threads=False, block_size=len(text) + 1, column_names=names),
            csv.ParseOptions(delimiter=delimiter, quote_char=False, ignore_empty_lines=False),
            csv.ConvertOptions(
                check_utf8=False,
                column_types=kinds,
                include_columns=list(kinds),
                null_values=[],
                strings_can_be_null=False,
            ),
        )
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):  # numpy's parser finds and names the row
        return None


def _texts(column: Any) -> NDArray[np.bytes_] | None:
    """A binary column as fixed-width text, when all cells are ASCII of one length."""
    _, offsets, data = column.buffers()
    ends = np.frombuffer(offsets, np.int32)[column.offset : column.offset + len(column) + 1]
    lengths = np.diff(ends)
    if not lengths.size or lengths[0] == 0 or (lengths != lengths[0]).any():
        return None
    codes = np.frombuffer(data, np.uint8)[ends[0] : ends[-1]]
    if codes.max() > 127:
        return None
    return codes.view(f"S{lengths[0]}")


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

    time : columns of the stamps, several of "text" only, or none; time_kind : "int", "float",
        "text" or ""
    values : columns of the numbers, in the order of the output
    text_width : bytes kept of a text stamp
    """

    delimiter: str
    decimal: str
    width: int
    time: tuple[int, ...]
    time_kind: str
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


def parse(lines: Lines, layout: Layout, where: str) -> Rows:
    """Parse a block of whole lines; blank cells become NaN.

    Blank lines are dropped in a file with time stamps and stand for a missing row otherwise; so are
    bad ones, which `Rows.bad` names. Raises UnreadableInput when more than half of them are bad.
    """
    rows = _whole(lines, layout)
    if rows is not None:
        at = np.array(lines.numbers, dtype=np.intp)
        return replace(rows, lines=at) if at.size == rows.values.shape[0] and at.size else rows
    good, numbers, bad = _good_lines(lines, layout, where)
    rows = _whole(good, layout)
    if rows is None or 2 * len(bad) > len(numbers) + len(bad):
        raise bad[0] if bad else _unclear(lines, where)
    at = np.array(numbers, dtype=np.intp)
    fits = at.size == rows.values.shape[0]
    return replace(rows, bad=tuple(bad), lines=at if fits else None)


def _whole(lines: Lines, layout: Layout) -> Rows | None:
    """The rows, if every line is one."""
    text, delimiter = lines.data, layout.delimiter
    if b'"' in text:
        text, delimiter = _unquoted(text, layout)
    if layout.decimal == ",":
        text = text.translate(_COMMA_TO_POINT)
    rows = _attempt(text, delimiter, layout, layout.time_kind)
    if rows is None:
        text = _completed(text, delimiter, layout)
        kind = "text" if layout.time_kind == "int" else layout.time_kind
        rows = _attempt(text, delimiter, layout, kind)
        if rows is not None and layout.time_kind == "int":
            rows = _with_integers(rows)
    return rows


def _attempt(text: bytes, delimiter: str, layout: Layout, kind: str) -> Rows | None:
    """The C parser's result if every line has all its cells and all wanted cells are numbers."""
    used = list(layout.time)
    if arrow_is_installed():
        time = (layout.time, kind) if used else None
        found = columns_of(text, delimiter, layout.width, time, layout.values)
        # A stamp as text would be cut to the width that is kept.
        cut = kind == "text" and any(
            part.dtype.itemsize > layout.text_width for part in (found[0] if found else ())
        )
        if found is not None and not cut:
            return Rows(joined(found[0]), _known(found[1]))
    count = text.count(b"\n")
    if not _complete(text, delimiter, layout.width, count):
        return None
    of_kind = {"int": "i8", "float": "f8", "text": f"S{layout.text_width}", "": "i8"}[kind]
    if count == 0:
        return Rows(np.empty(0, dtype=of_kind), np.empty((0, len(layout.values))))
    names = [f"t{k}" for k in range(len(used))]
    dtype = np.dtype([*((n, of_kind) for n in names), ("v", "f8", (len(layout.values),))])
    try:
        table = np.loadtxt(
            io.BytesIO(text),
            dtype=dtype,
            delimiter=None if delimiter == " " else delimiter,
            usecols=[*used, *layout.values],
            comments=None,
            ndmin=1,
        )
    except (ValueError, OverflowError):
        return None
    if table.size != count:
        return None
    stamps = joined([np.ascontiguousarray(table[n]) for n in names])
    values: Array = table["v"].reshape(count, len(layout.values))
    return Rows(stamps, _known(values))


def joined(stamps: Sequence[NDArray[np.generic]]) -> NDArray[np.generic]:
    """Stamps of one column, or of the parts that stand in several; blank where a part is."""
    if len(stamps) < 2:
        return stamps[0] if stamps else np.empty(0, dtype=np.int64)
    texts = [s.astype(np.bytes_) for s in stamps]
    blank = np.any([np.isin(t, [b"", b"nan", b"NaN"]) for t in texts], axis=0)
    whole = texts[0]
    for part in texts[1:]:
        whole = np.char.add(np.char.add(whole, b" "), part)
    whole[blank] = b""
    return whole


def _known(values: Array) -> Array:
    """Infinite values are none."""
    finite = np.isfinite(values)
    return values if finite.all() else np.where(finite, values, np.nan)


def _complete(text: bytes, delimiter: str, width: int, count: int) -> bool:
    if delimiter != " ":
        return text.count(delimiter.encode()) == count * (width - 1)
    codes = np.frombuffer(text, dtype=np.uint8)
    inside = codes > 32
    starts = int(np.count_nonzero(inside[1:] & ~inside[:-1])) + int(inside[:1].any())
    return starts == count * width


def _unquoted(text: bytes, layout: Layout) -> tuple[bytes, str]:
    """The text without quotes, and its delimiter (a quoted cell may hold the original one)."""
    count, bare = text.count(b"\n"), text.replace(b'"', b"")
    if layout.decimal != layout.delimiter and _complete(
        bare, layout.delimiter, layout.width, count
    ):
        return bare, layout.delimiter
    rows = csv.reader(
        io.StringIO(text.decode("utf-8", errors="replace")), delimiter=layout.delimiter
    )
    try:
        out = "".join("\t".join(c.strip() for c in row) + "\n" for row in rows)
    except csv.Error:
        return bare, layout.delimiter
    return out.encode(), "\t"


def _completed(text: bytes, delimiter: str, layout: Layout) -> bytes:
    """Blank cells and the words for missing values as nan; blank lines dropped or all nan."""
    if delimiter == " ":
        missing = b" ".join([b"nan"] * layout.width) + b"\n"
        text = re.sub(rb"(?m)^[ \t]*\n", b"" if layout.time else missing, text)
        return _MISSING.sub(b"nan", text)
    mark = delimiter.encode()
    missing = b"" if layout.time else mark * (layout.width - 1) + b"\n"
    text = re.sub(rb"(?m)^[ ]*\n", missing, text)
    blank = re.escape(mark)
    text = b"\n" + re.sub(rb"[ ]*(" + blank + rb"|\n)[ ]*", rb"\1", text)
    text = _MISSING.sub(b"nan", text)
    for _ in range(2):
        text = text.replace(mark + mark, mark + b"nan" + mark)
    text = text.replace(mark + b"\n", mark + b"nan\n").replace(b"\n" + mark, b"\nnan" + mark)
    return text[1:]


def _with_integers(rows: Rows) -> Rows | None:
    texts = np.char.strip(rows.stamps.astype(np.bytes_))
    blank = np.isin(texts, [b"nan", b"NaN", b""])
    stamps = np.full(texts.shape, MISSING, dtype=np.int64)
    filled: list[bytes] = texts[~blank].tolist()
    try:
        stamps[~blank] = np.fromiter(map(int, filled), np.int64, len(filled))
    except (ValueError, OverflowError):
        try:
            decimals = np.fromiter(map(float, filled), np.float64, len(filled))
        except ValueError:
            return None
        whole = np.rint(decimals)
        if not ((whole == decimals) & (np.abs(decimals) < _LARGEST_EXACT)).all():
            return None
        stamps[~blank] = whole.astype(np.int64)
    return Rows(stamps, rows.values)


def _good_lines(
    lines: Lines, layout: Layout, where: str
) -> tuple[Lines, list[int], list[UnreadableInput]]:
    """The lines without the bad ones, their numbers, and what is wrong with the others."""
    kept, numbers, bad = list[bytes](), list[int](), list[UnreadableInput]()
    mark = layout.delimiter.encode()
    missing = b" ".join([b"nan"] * layout.width) if mark == b" " else mark * (layout.width - 1)
    texts = lines.data.split(b"\n")[:-1]
    every = lines.numbers or range(lines.first_line, lines.first_line + len(texts))
    for number, line in zip(every, texts, strict=True):
        if not line.strip() and layout.time:
            continue
        wrong = line.strip() and _wrong(line.decode("utf-8", errors="replace"), layout)
        if wrong:
            what, column = wrong
            at = f"{where}: line {number}" + (f", column {column + 1}" if column >= 0 else "")
            bad.append(UnreadableInput(what, where=at, remedy="correct or delete that line"))
            if layout.time:
                continue
        kept.append((missing if wrong else line) + b"\n")
        numbers.append(number)
    return Lines(b"".join(kept), lines.first_line), numbers, bad


def _wrong(line: str, layout: Layout) -> tuple[str, int] | None:
    """What is wrong with a row, and in which column (-1: in all)."""
    row = cells_of(line, layout.delimiter)
    if len(row) != layout.width:
        return f"{len(row)} cells where the other rows have {layout.width}", -1
    stamps = layout.time if layout.time_kind in ("int", "float") else ()
    for column in (*stamps, *layout.values):
        cell = row[column]
        integer = column in stamps and layout.time_kind == "int"
        bad = not is_number(cell, layout.decimal) or (integer and not _INTEGER.fullmatch(cell))
        if bad and not is_blank(cell):
            return f"'{cell[:40]}' is not {'an integer' if integer else 'a number'}", column
    return None


def _unclear(lines: Lines, where: str) -> UnreadableInput:
    last = lines.first_line + lines.data.count(b"\n")
    span = f"{where}: lines {lines.first_line} to {last}"
    return UnreadableInput("a row cannot be read", where=span, remedy="look for odd characters")
