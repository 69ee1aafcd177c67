"""The first sheet of an XLSX file as the cells of a table, through openpyxl (extra `xlsx`)."""

from __future__ import annotations

import zipfile
from collections.abc import Collection
from pathlib import Path

from imucalib.errors import UnreadableInput
from imucalib.readers.csv.table import Cells, columns_of, selected
from imucalib.readers.source import small_directory
from imucalib.recording.mapping import FieldMapping

_MOST_BYTES, _MOST_ROWS, _MOST_COLUMNS, _FEWEST = 64 << 20, 100_000, 500, 3


def is_spreadsheet(path: Path) -> bool:
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


def sheet_cells(path: Path, mapping: FieldMapping, exclude: Collection[int] = ()) -> Cells:
    """The cells of the first sheet, as `table_cells` gives those of a text.

    mapping : `skip` and `where` are used. Formulas count by the value that was saved with them.
    Raises UnreadableInput with the row.
    """
    where = str(path)
    rows = _rows(path, mapping.skip or 0)
    while rows and sum(cell != "" for cell in rows[0][1]) < _FEWEST:
        del rows[0]
    if not rows:
        raise UnreadableInput("no table in its first sheet", where=where)
    width = max(k + 1 for k, cell in enumerate(rows[0][1]) if cell)
    cut = [row[:width] + [""] * (width - len(row)) for _, row in rows]
    top = f"{where}, row {rows[0][0]} of the sheet"
    return selected(columns_of(cut, top, where, decimal=",", exclude=exclude), mapping, where)


def _rows(path: Path, skip: int) -> list[tuple[int, list[str]]]:
    """Rows as text, with their numbers from 1."""
    try:
        import openpyxl
    except ImportError:
        raise UnreadableInput(
            "a spreadsheet needs openpyxl", where=str(path),
            remedy="pip install 'imucalib[xlsx]', or save it as CSV",
        ) from None  # fmt: skip
    try:
        with zipfile.ZipFile(path) as archive:
            claimed = sum(member.file_size for member in archive.infolist())
        if claimed > _MOST_BYTES:
            raise UnreadableInput(f"its parts claim {claimed} bytes", where=str(path))
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        try:
            sheet = book.worksheets[0]
            found = sheet.iter_rows(max_row=_MOST_ROWS, max_col=_MOST_COLUMNS, values_only=True)
            rows = [(n, [_text(c) for c in row]) for n, row in enumerate(found, start=1)]
        finally:
            book.close()
    except UnreadableInput:
        raise
    except Exception as error:  # what the package raises on damage depends on where the damage is
        raise UnreadableInput(
            f"the spreadsheet cannot be read: {error}", where=str(path),
            remedy="save it again, or as CSV",
        ) from error  # fmt: skip
    return [(n, row) for n, row in rows if n > skip]


def _text(cell: object) -> str:
    """A cell as text: numbers with all their digits."""
    return "" if cell is None else repr(cell) if isinstance(cell, float) else str(cell).strip()
