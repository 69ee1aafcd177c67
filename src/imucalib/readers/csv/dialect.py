"""The shape of a table: delimiter, decimal mark, heading, first row; from looks all over it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate

from imucalib.errors import UnreadableInput
from imucalib.readers.csv.text import COMMENT, cells_of, decode_text, is_blank, is_number
from imucalib.readers.devices.catalogue import rows_of_heading
from imucalib.readers.fields.choice import Field, find_vectors
from imucalib.readers.fields.words import instant_rank, understand
from imucalib.recording.mapping import FieldMapping
from imucalib.units import strip_brackets

_FEWEST = 20  # rows that show with how many decimals the last number is written
_DELIMITERS = (",", ";", "\t", "|", " ")
#: What some loggers write before the names of the columns.
_BEFORE_NAMES = re.compile(r"^\s*;\s*(headers\s*,)?\s*", re.IGNORECASE)
_HEADING = 4  # lines of it, at most: groups of groups, names, units


@dataclass(frozen=True)
class Dialect:
    """Shape of the table.

    delimiter : one character; " " stands for any run of blanks
    width : cells in a row; numeric : which columns hold numbers
    example : the cells of a row that has as many as any
    decimals : of the last number of every row, where these are equally many, else -1
    names : column names, or () without a header; units are a part of the names
    data_line : number of the first row's line, from 1; preamble : the lines above the table
    more : names of columns that only some rows have, which are not read
    """

    delimiter: str
    decimal: str
    width: int
    numeric: tuple[bool, ...] = ()
    example: tuple[str, ...] = ()
    decimals: int = -1
    names: tuple[str, ...] = ()
    data_line: int = 1
    preamble: tuple[str, ...] = ()
    more: tuple[str, ...] = ()

    def cells(self, line: str) -> list[str]:
        """The cells of a row, those that all rows have."""
        row = cells_of(line, self.delimiter)
        return row[: self.width] if len(row) == self.width + len(self.more) else row

    def address(self, column: int) -> str:
        """The name of a column where no other has it, else its number from 1."""
        name = self.names[column] if self.names else ""
        return name if name and self.names.count(name) == 1 else str(column + 1)

    def is_row(self, line: str) -> bool:
        """Whether a line has all cells, numbers or nothing where numbers are, one at least."""
        row = self.cells(line)
        if len(row) != self.width:
            return False
        used = [c for c, n in zip(row, self.numeric, strict=True) if n]
        good = [is_number(c, self.decimal) for c in used]
        return any(good) and all(g or is_blank(c) for g, c in zip(good, used, strict=True))

    def is_damaged_row(self, line: str) -> bool:
        """Whether a line above the table is mostly numbers: a damaged row, no header."""
        row = self.cells(line)
        if len(row) != self.width:
            good = sum(is_number(c, self.decimal) for c in row)
            return len(row) >= max(2, self.width - 1) and 2 * good > len(row)
        pairs = zip(row, self.numeric, strict=True)
        return 2 * sum(is_number(c, self.decimal) for c, n in pairs if n) > sum(self.numeric)

    def is_whole(self, line: bytes) -> bool:
        """Whether a last line without its end is a row: of a number that is cut, decimals lack."""
        row = cells_of(decode_text(line), self.delimiter)
        return len(row) == self.width and 0 < self.decimals == _decimals(row[-1], self.decimal)


def _decimals(cell: str, mark: str) -> int:
    """Digits after the decimal mark of a plain number; 0 of another."""
    plain = is_number(cell, mark) and "e" not in cell.lower()
    return len(cell.partition(mark)[2]) if plain else 0


def sniff(pieces: Sequence[bytes], mapping: FieldMapping, where: str) -> Dialect:
    """The dialect that explains the lines from all over the file best.

    The start alone misleads: it may be zeros, or a header. Raises UnreadableInput when no table
    of numbers is found.
    """
    lines = [decode_text(piece).split("\n")[:-1] for piece in pieces]
    body = _body(lines, mapping.skip or 0)
    text = "".join(body)
    delimiters = [mapping.delimiter] if mapping.delimiter else list(_DELIMITERS)
    # Of those that are nowhere, which all give one cell, the first is enough.
    delimiters = delimiters[:1] + [d for d in delimiters[1:] if d in text or d == " "]
    marks = [mapping.decimal] if mapping.decimal else [".", ","] if "," in text else ["."]
    best, most = Dialect("", "", 0), 0
    for delimiter in delimiters:
        rows = [cells_of(line, delimiter) for line in body]
        for mark in marks:
            if mark == delimiter and '"' not in text:
                continue
            counts: Counter[int] = Counter()  # numeric cells by the width of their rows
            for row in rows:
                counts[len(row)] += sum(is_number(c, mark) for c in row)
            width, score = max(counts.items(), key=lambda kv: kv[1], default=(0, 0))
            if score > most:
                best, most = Dialect(delimiter, mark, width), score
    if not most:
        raise UnreadableInput(
            "no table of numbers was found in the text",
            where=where,
            remedy="give --skip, --delimiter and --decimal if the file holds one",
        )
    rows = [r for r in (cells_of(line, best.delimiter) for line in body) if len(r) == best.width]
    numeric = []
    for column in zip(*rows, strict=True):
        numbers = sum(is_number(c, best.decimal) for c in column)
        numeric.append(numbers > 0 and numbers + sum(map(is_blank, column)) > 0.5 * len(rows))
    last = {_decimals(row[-1], best.decimal) for row in rows}
    found = replace(
        best,
        numeric=tuple(numeric),
        example=tuple(max(rows, key=lambda row: sum(not is_blank(cell) for cell in row))),
        decimals=last.pop() if len(last) == 1 and len(rows) >= _FEWEST else -1,
    )
    return _with_header(found, lines[0], mapping, where)


def _body(pieces: list[list[str]], skip: int) -> list[str]:
    """Lines that are surely data, if the file has any: from the middle of each piece."""
    chosen: list[str] = []
    for k, piece in enumerate(pieces):
        lines = [line for line in (piece if k else piece[skip:]) if line.strip()]
        chosen += lines[len(lines) // 2 :][: 20 if k else 200]
    return chosen


def _with_header(shape: Dialect, lines: list[str], mapping: FieldMapping, where: str) -> Dialect:
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
    given = mapping.skip is not None or mapping.header
    rows = 0 if given else rows_of_heading(lines[first:])
    first += rows
    above = [k for k in range(start, first) if lines[k].strip()]
    # A heading that is repeated after the zero bytes of a power failure is the one above.
    whole = {lines[k] for k in above}
    above = [k for k in above if "\0" not in lines[k] or lines[k].strip("\0") not in whole]
    while above and not given and not rows and shape.is_damaged_row(lines[above[-1]]):
        first = above.pop()
    names = () if mapping.header is False else _names([lines[k] for k in above], shape)
    if not names and above and mapping.header is not False:
        every = _wide_names(lines, above[-1], shape)
        names, shape = every[: shape.width], replace(shape, more=every[shape.width :])
    if any(c < " " for name in names for c in name):
        raise UnreadableInput(
            "the heading is damaged: it holds control characters",
            where=f"{where}: line {above[-1] + 1}",
            remedy="copy the file again, or correct that line",
        )
    return replace(shape, names=names, data_line=first + 1, preamble=tuple(lines[:first]))


def _wide_names(lines: list[str], heading: int, shape: Dialect) -> tuple[str, ...]:
    """The words of a heading that has more of them than most rows have cells, where some row below
    has as many; none else."""
    bare = _BEFORE_NAMES.sub("", COMMENT.sub("", lines[heading]))
    names = cells_of(bare, shape.delimiter)
    words = len(names) > shape.width and all(any(map(str.isalpha, name)) for name in names)
    below = (cells_of(line, shape.delimiter) for line in lines[heading + 1 :]) if words else ()
    return tuple(names) if any(len(row) == len(names) for row in below) else ()


def _names(above: list[str], shape: Dialect) -> tuple[str, ...]:
    """Column names from the last lines above the table: from the last alone, or from it and those
    above together (groups of columns, axes, units), where these tell more sensors."""
    rows = list[tuple[str, ...]]()
    for line in reversed(above[-_HEADING:]):
        cells = _split_names(line, shape) or _fill_cells(line, shape, merged=bool(rows))
        if not cells:
            break
        rows.insert(0, cells)
    if not rows:
        return ()
    found, score = rows[-1], (-1, -1)
    for first in reversed(range(len(rows))):
        names = rows[-1] if first == len(rows) - 1 else _join_rows(rows[first:])
        told = understand(names)
        axes = [v for v in find_vectors([Field(n) for n in names], told) if len(v.parts) == 3]
        own = len(axes), sum(any(m.quantity == q for m in told) for q in ("time", "temperature"))
        if own > score and any(map(any, names)):
            found, score = names, own
    return found if score > (0, 0) or _split_names(above[-1], shape) else ()


def _join_rows(rows: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """One name a column out of several rows of heading; a last row that names no axis has units."""
    upper, lower = rows[0] if len(rows) == 2 else _join_rows(rows[:-1]), rows[-1]
    axes = any(m.is_axis for m in understand(lower)) or {"x", "y", "z"} & set(map(str.lower, lower))
    named = [axes or instant_rank(cell) >= 0 for cell in lower]
    whole = [
        f"{u}_{low}" if own else f"{u} [{strip_brackets(low)}]"
        for u, low, own in zip(upper, lower, named, strict=True)
    ]
    return tuple(
        w if u and low else u or low for w, u, low in zip(whole, upper, lower, strict=True)
    )


def _fill_cells(line: str, shape: Dialect, *, merged: bool) -> tuple[str, ...]:
    """The cells of a heading that lacks some; none of another line. merged : whether each goes on
    up to the next"""
    cells = cells_of(COMMENT.sub("", line), shape.delimiter)
    if len(cells) != shape.width or not 0 < sum(map(bool, cells)) < shape.width:
        return ()
    if any(is_number(cell, shape.decimal) for cell in cells):
        return ()
    return tuple(accumulate(cells, lambda last, cell: cell or last)) if merged else tuple(cells)


def _split_names(line: str, shape: Dialect) -> tuple[str, ...]:
    bare, width = COMMENT.sub("", line), shape.width
    for candidate in (shape.delimiter, ",", ";", "\t", " "):
        names = cells_of(bare if candidate == ";" else _BEFORE_NAMES.sub("", bare), candidate)
        if len(names) == width + 1 and not names[-1]:
            names = names[:-1]
        merged = any(candidate in n or '"' in n for n in names)  # a lost quote joins two names
        if len(names) == width - 1 and not shape.example[-1] and not merged:
            names = [*names, ""]
        if len(names) == width and sum(any(ch.isalpha() for ch in n) for n in names) * 2 >= width:
            return tuple(names)
    return ()
