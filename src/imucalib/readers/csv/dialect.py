"""Where the table of a text file starts, what separates its cells, and what its header states."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from imucalib.errors import UnreadableInput
from imucalib.readers.columns import understand
from imucalib.readers.devices.catalogue import rows_of_heading
from imucalib.recording.mapping import FieldMapping
from imucalib.units import without_brackets

BLANK = {"", "nan", "na", "n/a", "null", "none", "-", "--", "#n/a", "?", "inf", "-inf", "+inf",
         "#value!", "#ref!", "#div/0!", "#num!", "#name?", "#null!"}  # fmt: skip
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
        raise UnreadableInput("no data row was found near the start", where=where)
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
