"""The cells of a small table under its headings, as text: what a recording's columns are not."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from imucalib.errors import UnreadableInput
from imucalib.readers.csv.dialect import cells_of, decoded, is_comment, is_number
from imucalib.readers.csv.source import whole_text
from imucalib.recording.mapping import FieldMapping
from imucalib.units import ACCELERATION_UNITS, ANGLE_UNITS, RATE_UNITS, canonical, without_brackets

_BINARY = re.compile(rb"[\0\xfe\xff]")  # in no text of UTF-8, and in no table of Windows-1252
_FEWEST = 3  # cells of a heading
_UNITS = {*ACCELERATION_UNITS, *RATE_UNITS, *ANGLE_UNITS}
_OTHER_UNITS = {"°", "degc", "°c", "c", "k", "s", "ms", "counts", "count", "lsb", "-"}
_DELIMITERS = (",", ";", "\t", "|")


def table_cells(path: Path, mapping: FieldMapping) -> dict[str, list[str]]:
    """Every column by its heading, in the file's order; numbers with a point as decimal mark.

    mapping : `skip`, `delimiter` and `decimal` are used. A decimal comma is understood wherever
        the comma does not separate the cells. Comments and blank lines are passed over, title lines
        above the heading too; a row of units below it goes into the headings.
    Raises UnreadableInput with the row, counted from 1 below the heading.
    """
    where = str(path)
    lines = list(_lines(path, mapping.skip or 0))
    if not lines:
        raise UnreadableInput("no rows in it", where=where)
    lines = _without_titles(lines, mapping.delimiter)
    at, first = lines[0]
    delimiter = mapping.delimiter or max(_DELIMITERS, key=first.count)
    heading, *rows = [cells_of(line, delimiter) for _, line in lines]
    commas = mapping.decimal == "," or (not mapping.decimal and delimiter != ",")
    return columns_of([heading, *rows], f"{where}, line {at}", where, commas=commas)


def columns_of(
    rows: list[list[str]], top: str, where: str, *, commas: bool
) -> dict[str, list[str]]:
    """Every column by its heading, the first row; `top` says where that is. Errors as above."""
    heading, *rows = rows
    if rows and len(rows[0]) == len(heading) and _are_units(rows[0]):
        units = rows.pop(0)
        heading = [_with_unit(n, u) for n, u in zip(heading, units, strict=True)]
    if all(is_number(cell) or (commas and is_number(cell, ",")) for cell in heading if cell):
        raise UnreadableInput(
            "the first row is numbers, not headings", where=top,
            remedy="add a heading line such as: inclination,tool_face,x,y,z",
        )  # fmt: skip
    if len(set(heading)) != len(heading):
        raise UnreadableInput("two columns have the same heading", where=top)
    for number, row in enumerate(rows, start=1):
        if len(row) != len(heading):
            raise UnreadableInput(
                f"{len(row)} cells where the heading has {len(heading)}",
                where=f"{where}, row {number}",
                remedy="complete the row, or give --delimiter and --decimal",
            )
    if not rows:
        raise UnreadableInput("a heading but no rows", where=where)
    return {name: [_plain_number(row[k], commas) for row in rows] for k, name in enumerate(heading)}


def _without_titles(lines: list[tuple[int, str]], delimiter: str) -> list[tuple[int, str]]:
    """The lines from the first that has three cells with something in them."""
    for k, (_, line) in enumerate(lines):
        mark = delimiter or max(_DELIMITERS, key=line.count)
        if sum(cell != "" for cell in cells_of(line, mark)) >= _FEWEST:
            return lines[k:]
    return lines


def _are_units(row: list[str]) -> bool:
    """Whether every cell is a unit, or nothing."""
    texts = [without_brackets(cell) for cell in row if cell]
    return bool(texts) and all(
        canonical(text) in _UNITS or text.lower() in _OTHER_UNITS for text in texts
    )


def _with_unit(name: str, cell: str) -> str:
    """The heading with the unit below it, unless it states one."""
    unit = without_brackets(cell).replace("°", "deg")
    return name if not unit or name.endswith((")", "]")) else f"{name} [{unit}]"


def _plain_number(cell: str, commas: bool) -> str:
    """The cell with a point, without a degree sign and with the minus of a keyboard."""
    text = cell.replace("\u2212", "-")
    text = text.removesuffix("°").rstrip()
    text = text.replace(",", ".") if commas and is_number(text, ",") else text
    return text if is_number(text) else cell


def _lines(path: Path, skip: int) -> Iterator[tuple[int, str]]:
    """Lines that hold something, with their numbers from 1."""
    data = whole_text(path)
    binary = _BINARY.search(data)
    if binary:
        raise UnreadableInput(
            "not a text file", where=f"{path}, byte {binary.start()}",
            remedy="give a CSV or HDF5 table; save a spreadsheet as CSV",
        )  # fmt: skip
    text = decoded(data)
    for number, line in enumerate(text.split("\n"), start=1):
        if number > skip and line.strip() and not is_comment(line):
            yield number, line
