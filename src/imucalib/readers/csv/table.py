"""The cells of a small table under its headings, as text: what a recording's columns are not.

A text, or the first sheet of an XLSX file through openpyxl (extra `xlsx`).
"""

from __future__ import annotations

import re
import zipfile
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput, UsageError
from imucalib.readers.csv.text import (
    COMMENT,
    Condition,
    cells_of,
    decode_text,
    is_number,
    no_row_has,
    text_head,
    whole_text,
)
from imucalib.readers.fields.source import head_of, small_directory
from imucalib.recording.mapping import FieldMapping
from imucalib.units import ACCELERATION_UNITS, ANGLE_UNITS, RATE_UNITS, canonical, strip_brackets

_BINARY = re.compile(rb"[\0\xfe\xff]")  # in no text of UTF-8, and in no table of Windows-1252
_FEWEST = 3  # cells of a heading
_UNITS = {*ACCELERATION_UNITS, *RATE_UNITS, *ANGLE_UNITS}
_OTHER_UNITS = {"°", "degc", "°c", "c", "k", "s", "ms", "counts", "count", "lsb", "-"}
_DELIMITERS = (",", ";", "\t", "|")
_LOOKED = 200  # lines that show the delimiter
_LONGEST = 1 << 16  # characters of a line of a table
_SHOWN = 10  # rows that an error lists
_MOST_BYTES, _MOST_ROWS, _MOST_COLUMNS = 64 << 20, 100_000, 500  # of a workbook
_RULE = re.compile(r"\|[\s|:\-]+\|")  # below the heading of a Markdown table
#: Numbers that show by two marks of thousands, or by one beside the decimal mark, which it is.
_GROUPED = {
    ",": re.compile(r"[+-]?\d{1,3}((,\d{3})+\.\d*|(,\d{3}){2,})"),
    ".": re.compile(r"[+-]?\d{1,3}((\.\d{3})+,\d*|(\.\d{3}){2,})"),
}
_WITH = {
    ",": re.compile(r"[+-]?\d{1,3}(,\d{3})+(\.\d*)?"),
    ".": re.compile(r"[+-]?\d{1,3}(\.\d{3})+(,\d*)?"),
}
_BLANK_BETWEEN = re.compile(r"(?<=\d)[\u00a0\u202f\u2009'\u2019](?=\d{3})")


@dataclass(frozen=True)
class Cells:
    """A small table.

    columns : heading -> cells, in the file's order; row : numbers of the rows that are here, from 1
    below the heading; file_rows : that the file has; notes : what was left out
    """

    columns: Mapping[str, Array | list[str]]
    row: tuple[int, ...]
    file_rows: int
    notes: tuple[str, ...] = ()

    def at(self, keep: Sequence[int]) -> Cells:
        """Some of the rows, by their places from 0."""
        columns = {
            n: v[list(keep)] if isinstance(v, np.ndarray) else [v[k] for k in keep]
            for n, v in self.columns.items()
        }
        return replace(self, columns=columns, row=tuple(self.row[k] for k in keep))


def table_cells(
    path: Path, mapping: FieldMapping, exclude: Collection[int] = (), most: int = 0
) -> Cells:
    """The cells of a text or of the first sheet of a workbook; numbers with a point as decimal mark
    and no mark of thousands.

    mapping : `skip`, `delimiter`, `decimal` and `where` are used. A decimal comma is understood
        wherever the comma does not separate the cells. Comments and blank lines are passed over,
        title lines above the heading too, the frame of a Markdown table, and lines below the last
        blank one that are no rows; a row of units below the heading goes into it. Formulas count
        by the value that was saved with them.
    exclude : rows that may have any number of cells; most : rows of a text after which no more
        are read, all where it is 0
    Raises UnreadableInput with the row, counted from 1 below the heading.
    """
    if _is_spreadsheet(path):
        (rows, top), decimal, stated = _sheet(path, mapping.skip or 0), ",", False
    else:
        rows, top, delimiter = _text(path, mapping, most)
        decimal, stated = mapping.decimal or "," * (delimiter != ","), bool(mapping.decimal)
    found = _columns_of(rows, top, str(path), decimal=decimal, stated=stated, exclude=exclude)
    return select_rows(found, mapping, str(path))


def select_rows(cells: Cells, mapping: FieldMapping, where: str) -> Cells:
    """The rows that `mapping.where` names. Raises UsageError for a column that is not there."""
    wanted = [Condition.of(text) for text in mapping.where]
    for condition in wanted:
        if condition.name not in cells.columns:
            raise UsageError(
                f"no column '{condition.name}'",
                where="--where",
                remedy=f"columns: {', '.join(cells.columns)}",
            )
    texts = [[str(cell) for cell in cells.columns[c.name]] for c in wanted]
    fits = [[c.fits(cell) for cell in column] for c, column in zip(wanted, texts, strict=True)]
    keep = [k for k in range(len(cells.row)) if all(column[k] for column in fits)]
    if wanted and not keep:
        raise no_row_has(mapping.where, texts, where)
    return cells.at(keep) if wanted else cells


def _columns_of(
    rows: list[list[str]],
    top: str,
    where: str,
    *,
    decimal: str,
    stated: bool,
    exclude: Collection[int],
) -> Cells:
    """Every column by its heading, the first row; `top` says where that is.

    decimal : "," where that may be the mark, or the mark itself where it is `stated`
    """
    heading, *rows = rows
    if rows and len(rows[0]) == len(heading) and _are_units(rows[0]):
        units = rows.pop(0)
        heading = [_add_unit(n, u) for n, u in zip(heading, units, strict=True)]
    comma = decimal == ","
    if all(is_number(cell) or (comma and is_number(cell, ",")) for cell in heading if cell):
        raise UnreadableInput(
            "the first row is numbers, not headings",
            where=top,
            remedy="add a heading line such as: inclination,tool_face,x,y,z",
        )
    heading = [name or f"column {k}" for k, name in enumerate(heading, start=1)]
    if twice := [name for k, name in enumerate(heading) if name in heading[:k]]:
        raise UnreadableInput(
            f"two columns have the same heading '{twice[0]}'",
            where=top,
            remedy="rename one of them, or take it out",
        )
    thousands = _thousands([cell for row in rows for cell in row], decimal, stated)
    rows, lost = _drop_footer(
        [[_plain_number(cell, comma, thousands) for cell in row] for row in rows]
    )
    notes = [f"below the table, left out: {' | '.join(filter(None, row))}" for row in lost]
    kept = [k for k, row in enumerate(rows) if len(row) == len(heading) or k + 1 not in exclude]
    wrong = [k for k in kept if len(rows[k]) != len(heading)]
    if wrong:
        more = and_more([f"row {k + 1}" for k in wrong[1:]])
        raise UnreadableInput(
            f"{len(rows[wrong[0]])} cells where the heading has {len(heading)}{more}",
            where=f"{where}, row {wrong[0] + 1}",
            remedy="complete the row, or give --delimiter and --decimal",
        )
    if not rows:
        raise UnreadableInput(
            "a heading but no rows",
            where=where,
            remedy="write a row a position below it; --skip where the heading stands further down",
        )
    columns = {name: [rows[k][c] for k in kept] for c, name in enumerate(heading)}
    return Cells(columns, tuple(k + 1 for k in kept), len(rows), tuple(notes))


def and_more(places: Sequence[str]) -> str:
    """The first ten of some places, and how many there are."""
    if not places:
        return ""
    more = len(places) - _SHOWN + 1
    shown = ", ".join(places[: _SHOWN - 1]) + (f" and {more} more" if more > 0 else "")
    return f"; {len(places) + 1} in all: also {shown}"


def _drop_footer(rows: list[list[str]]) -> tuple[list[list[str]], list[list[str]]]:
    """The rows with something in them, and those below the last empty one that lack a number where
    every row above has one (means, remarks)."""
    last = max((k for k, row in enumerate(rows) if any(row)), default=-1)
    empty = [k for k, row in enumerate(rows[: last + 1]) if not any(row)]
    above = [row for row in rows[: empty[-1]] if any(row)] if empty else []
    below = [row for row in rows[empty[-1] :] if any(row)] if empty else []
    width = min(map(len, above), default=0)
    full = [c for c in range(width) if all(is_number(row[c]) for row in above)]
    if full and not any(all(c < len(row) and is_number(row[c]) for c in full) for row in below):
        return above, below
    return [row for row in rows if any(row)], []


def _thousands(cells: Sequence[str], decimal: str, stated: bool) -> str:
    """The mark between thousands that some numbers of a table show beyond doubt, or ""."""
    found = {mark for mark, form in _GROUPED.items() if any(map(form.fullmatch, cells))}
    if stated and not found:
        return "," if decimal == "." else "."
    return found.pop() if len(found) == 1 else ""


def _text(path: Path, mapping: FieldMapping, most: int) -> tuple[list[list[str]], str, str]:
    """Rows of cells, the heading first, where that is, and the delimiter."""
    lines = list(_lines(path, mapping.skip or 0, most))
    if not any(line for _, line in lines):
        raise UnreadableInput("no rows in it", where=str(path))
    delimiter = mapping.delimiter or _delimiter_of([line for _, line in lines])
    rows = [_cells(line, delimiter) for _, line in lines]
    at, rows = _from_heading(rows)
    return rows, f"{path}, line {lines[at][0]}", delimiter


def _delimiter_of(lines: Sequence[str]) -> str:
    """The delimiter of the lines that hold most numbers, or else of most cells; blanks where there
    is no other."""
    some = lines[:_LOOKED]

    def numbers(mark: str) -> tuple[int, int]:
        rows = [[c for c in cells_of(line, mark) if c] for line in some]
        cells = [cell for row in rows if len(row) > 1 for cell in row]
        return sum(map(_reads, cells)), len(cells)

    best = max(_DELIMITERS, key=numbers)
    return best if max(numbers(best)) else " "


def _reads(cell: str) -> bool:
    grouped = any(form.fullmatch(cell) for form in _WITH.values())
    return grouped or is_number(cell) or is_number(cell, ",")


def _from_heading(rows: list[list[str]]) -> tuple[int, list[list[str]]]:
    """Where the heading is, and the rows from there: above the block of numbers, beyond a row of
    units; where there is none, the first row with three cells. Names that repeat get those of the
    groups above them."""
    widths = Counter(len(row) for row in rows if 2 * sum(map(_reads, row)) > sum(map(bool, row)))
    width = next((w for w, _ in widths.most_common() if w > 1), 0)
    many = [sum(map(_reads, row)) for row in rows]
    data = next(
        # Of a row of numbers half of the cells with something in them are.
        (
            k
            for k, row in enumerate(rows)
            if len(row) == width and many[k] >= max(2, 0.5 * sum(map(bool, row)))
        ),
        None,
    )
    filled = [k for k, row in enumerate(rows[:data]) if any(row)]
    units = bool(filled) and _are_units(rows[filled[-1]])
    names = filled[:-1] if units else filled
    if data is None or not names:
        wide = (k for k, row in enumerate(rows) if sum(map(bool, row)) >= _FEWEST)
        at = next(wide, 0)
        return at, rows[at:]
    at, between = names[-1], rows[filled[-1] : filled[-1] + 1] if units else []
    heading = list(rows[at])
    groups = rows[names[-2]] if len(names) > 1 else []
    again = {name for name, count in Counter(heading).items() if name and count > 1}
    if again and len(groups) == len(heading):
        merged = [next(filter(None, groups[k::-1]), "") for k in range(len(groups))]
        heading = [
            f"{name} {group}" if name in again and group else name
            for name, group in zip(heading, merged, strict=True)
        ]
    return at, [heading, *between, *rows[data:]]


def _cells(line: str, delimiter: str) -> list[str]:
    """The cells of a line; blanks inside a name are one, so two or more separate where they can."""
    if delimiter == " " and '"' not in line:
        wide = re.split(r"\s{2,}|\t", line.strip())
        return wide if len(wide) >= _FEWEST else line.split()
    return cells_of(line, delimiter)


def _are_units(row: list[str]) -> bool:
    """Whether every cell is a unit, or nothing."""
    texts = [strip_brackets(cell) for cell in row if cell]
    return bool(texts) and all(
        canonical(text) in _UNITS or text.lower() in _OTHER_UNITS for text in texts
    )


def _add_unit(name: str, cell: str) -> str:
    """The heading with the unit below it, unless it states one."""
    unit = strip_brackets(cell).replace("°", "deg")
    return name if not unit or name.endswith((")", "]")) else f"{name} [{unit}]"


def _plain_number(cell: str, comma: bool, thousands: str) -> str:
    """The cell with a point, without a degree sign, with the minus of a keyboard and without marks
    between thousands."""
    if thousands != "." and is_number(cell):
        return cell
    text = _BLANK_BETWEEN.sub("", cell.replace("\u2212", "-"))
    text = text.removesuffix("°").rstrip()
    if thousands and _WITH[thousands].fullmatch(text):
        text = text.replace(thousands, "")
    if (comma or thousands == ".") and is_number(text, ","):
        text = text.replace(",", ".")
    return text if is_number(text) else cell


def _lines(path: Path, skip: int, most: int) -> Iterator[tuple[int, str]]:
    """Lines that are no remarks, blank ones too, with their numbers from 1, about `most` at least
    unless that is 0."""
    # Of a log of gigabytes no more is read.
    _demand_text(text_head(head_of(path)) or b"\0", path)
    data = whole_text(path, most)
    _demand_text(data, path)
    text = decode_text(data)
    for number, line in enumerate(text.split("\n"), start=1):
        if len(line) > _LONGEST:
            what, remedy = f"a line of {len(line)} characters", "give a table, a row a position"
            raise UnreadableInput(what, where=f"{path}, line {number}", remedy=remedy)
        bare = line.strip()
        if number <= skip or COMMENT.match(line) or _RULE.fullmatch(bare):
            continue
        yield number, bare.removeprefix("|").removesuffix("|").strip() if bare[:1] == "|" else line


def _demand_text(data: bytes, path: Path) -> None:
    binary = _BINARY.search(data)
    if binary:
        raise UnreadableInput(
            "not a text file",
            where=f"{path}, byte {binary.start()}",
            remedy="give a CSV or HDF5 table, and save a spreadsheet as CSV; of a recording the "
            "rests are read with --reference norm, or beside a table with --recording",
        )


def _is_spreadsheet(path: Path) -> bool:
    """Whether the file is a zip archive that holds a workbook."""
    try:
        with path.open("rb") as stream:
            if stream.read(4) != b"PK\x03\x04":
                return False
        if not small_directory(path):
            return False
        with zipfile.ZipFile(path) as archive:
            return "xl/workbook.xml" in archive.namelist()
    except (OSError, zipfile.BadZipFile):
        return False


def _sheet(path: Path, skip: int) -> tuple[list[list[str]], str]:
    """Rows of cells of the first sheet, the heading first, and where that is."""
    rows = _sheet_rows(path)[skip:]
    if not any(sum(map(bool, row)) >= _FEWEST for row in rows):
        raise UnreadableInput("no table in its first sheet", where=str(path))
    at, rows = _from_heading(rows)
    width = max(k + 1 for k, cell in enumerate(rows[0]) if cell)
    cut = [row[:width] + [""] * (width - len(row)) for row in rows]
    return cut, f"{path}, row {skip + at + 1} of the sheet"


def _sheet_rows(path: Path) -> list[list[str]]:
    """All rows of the first sheet as text."""
    try:
        import openpyxl
    except ImportError:
        raise UnreadableInput(
            "a spreadsheet needs openpyxl",
            where=str(path),
            remedy="pip install 'imucalib[xlsx]', or save it as CSV",
        ) from None
    try:
        with zipfile.ZipFile(path) as archive:
            claimed = sum(member.file_size for member in archive.infolist())
        if claimed > _MOST_BYTES:
            raise UnreadableInput(f"its parts claim {claimed} bytes", where=str(path))
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        try:
            sheet = book.worksheets[0]
            found = sheet.iter_rows(max_row=_MOST_ROWS, max_col=_MOST_COLUMNS, values_only=True)
            return [[_cell(c) for c in row] for row in found]
        finally:
            book.close()
    except UnreadableInput:
        raise
    except Exception as error:  # what the package raises on damage depends on where the damage is
        raise UnreadableInput(
            f"the spreadsheet cannot be read: {error}",
            where=str(path),
            remedy="save it again, or as CSV",
        ) from error


def _cell(cell: object) -> str:
    """A cell as text: numbers with all their digits."""
    return "" if cell is None else repr(cell) if isinstance(cell, float) else str(cell).strip()
