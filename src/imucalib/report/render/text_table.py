"""A table in characters: never wrapped inside a number, split into parts where it is too wide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich.cells import cell_len
from rich.text import Text as Line

from imucalib.report.document import Table, Tone
from imucalib.report.render.columns import column_pads, squared
from imucalib.report.render.terminal import clipped, one_line, wrapped

GAP = 2
NARROWEST = 14  # cells that a left-aligned column keeps before the table is split
MEASURE = 100
_STYLES: dict[Tone, str] = {"ok": "green", "warning": "yellow", "bad": "bold red", "plain": ""}
_SIGNS: dict[Tone, str] = {"ok": "✓", "warning": "!", "bad": "✗", "plain": " "}


@dataclass(frozen=True)
class _Column:
    """Header and cells, on one line each, and the widths that they need."""

    header: str
    cells: tuple[str, ...]
    right: bool

    @property
    def width(self) -> int:
        """Cells of a terminal that the column takes when nothing is folded."""
        return max(cell_len(text) for text in (self.header, *self.cells))

    @property
    def folded(self) -> int:
        """Cells that it takes when only its header is folded."""
        words = [cell_len(word) for word in self.header.split()]
        return max([*words, 1, *(cell_len(text) for text in self.cells)])

    @property
    def least(self) -> int:
        """Cells below which the table is rather split: no number is ever cut before that."""
        return self.folded if self.right else min(self.folded, NARROWEST)


def table_lines(table: Table, width: int) -> list[Line]:
    """The rows of the table, none wider than `width` cells.

    Columns of text shrink first and fold their words; what is still too wide follows below, with
    the first column repeated.
    """
    lines = [Line(row, "bold") for row in wrapped(one_line(table.title), min(width, MEASURE))]
    columns, signs = _columns(table), any(tone != "plain" for tone in table.tones.values())
    for n, part in enumerate(_parts(columns, width - 2 * signs)):
        if n:
            lines.append(Line())
        lines += _part_lines(part, table, width - 2 * signs, signs)
    return lines + [Line(row, "dim") for row in wrapped(one_line(table.note), min(width, MEASURE))]


def _columns(table: Table) -> list[_Column]:
    header, rows, align = squared(table)
    pads = column_pads(table)
    return [
        _Column(
            one_line(name),
            tuple(one_line(row[j]) + " " * pads[j][i] for i, row in enumerate(rows)),
            align[j] == "r",
        )
        for j, name in enumerate(header)
    ]


def _parts(columns: list[_Column], width: int) -> list[list[_Column]]:
    """Groups of columns that fit side by side, each starting with the first column."""
    first, rest = columns[:1], columns[1:]
    parts, part = [], first
    for column in rest:
        if sum(c.least + GAP for c in (*part, column)) - GAP > width and len(part) > 1:
            parts.append(part)
            part = first
        part = [*part, column]
    return [*parts, part]


def _widths(part: list[_Column], width: int) -> list[int]:
    """Natural widths; where too wide, headers fold first, then texts, then all is cut."""
    widths = [column.width for column in part]
    spare = max(width - GAP * (len(part) - 1), len(part))
    for floors in ([c.folded for c in part], [c.least for c in part], [1] * len(part)):
        while sum(widths) > spare and any(map(int.__gt__, widths, floors)):
            j = max(range(len(part)), key=lambda k: (widths[k] > floors[k], widths[k]))
            widths[j] -= 1
    return widths


def _part_lines(part: list[_Column], table: Table, width: int, signs: bool) -> list[Line]:
    widths = _widths(part, width)
    lead = " " * 2 if signs else ""
    total = sum(widths) + GAP * (len(part) - 1) + len(lead)
    header = _row([c.header for c in part], part, widths, header=True)
    lines = [Line(lead + row, "bold") for row in header]
    lines.append(Line("─" * total, "dim"))
    for i in range(len(part[0].cells)):
        tone = table.tones.get(i, "plain")
        for k, row in enumerate(_row([c.cells[i] for c in part], part, widths)):
            sign = f"{_SIGNS[tone] if k == 0 else ' '} " if signs else ""
            lines.append(Line(sign + row, _STYLES[tone]))
    return lines


def _row(
    cells: Sequence[str], part: list[_Column], widths: list[int], *, header: bool = False
) -> list[str]:
    """One row as lines: texts fold, numbers stay whole; a header sits on the rule below it."""
    folded = [
        [clipped(cell, size)] if column.right and not header else wrapped(cell, size) or [""]
        for cell, column, size in zip(cells, part, widths, strict=True)
    ]
    height = max(len(rows) for rows in folded)
    filled = [
        [""] * (height - len(rows)) + rows if header else rows + [""] * (height - len(rows))
        for rows in folded
    ]
    return [
        (" " * GAP).join(
            _placed(rows[k], size, column.right)
            for rows, column, size in zip(filled, part, widths, strict=True)
        )
        for k in range(height)
    ]


def _placed(text: str, size: int, right: bool) -> str:
    spare = " " * (size - cell_len(text))
    return spare + text if right else text + spare
