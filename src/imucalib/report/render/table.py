"""A table laid out: decimal points under each other, and as characters.

Numbers are never wrapped; a table that is too wide is split into parts.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rich.box import Box
from rich.cells import cell_len
from rich.console import RenderableType
from rich.padding import Padding
from rich.table import Table as Grid
from rich.text import Text as Line

from imucalib.report.render.document import Table
from imucalib.report.render.terminal import SIGNS, STYLES, one_line

_NUMBER = re.compile(r"[<>≤≥~±+\-−]*\s?\d[\d,   ]*(?:\.(?P<decimals>[\d   ]*))?(?P<tail>.*)")
_ABSENT = frozenset({"", "-", "–", "—", "n/a"})
MOST = 8  # a wider pad would cost more room than the alignment gives back
GAP = 2
NARROWEST = 14  # cells that a left-aligned column keeps before the table is split
#: A rule under the header and nothing else.
_RULED = Box("    \n    \n ── \n    \n    \n    \n    \n    \n")


def decimal_pads(cells: Sequence[str]) -> tuple[int, ...]:
    """Characters to add after each cell so that decimal points align; zeros for mixed content.

    Cells with a tail of their own, such as an exponent or a unit, stay as they are.
    """
    tails: list[int | None] = []
    for cell in cells:
        found = _NUMBER.fullmatch(cell.strip())
        if found and not found["tail"]:
            decimals = found["decimals"]
            tails.append(0 if decimals is None else 1 + len(decimals))
        elif cell.strip() in _ABSENT:
            tails.append(None)
        else:
            return (0,) * len(cells)
    widest = max((tail for tail in tails if tail is not None), default=0)
    if widest > MOST:
        return (0,) * len(cells)
    return tuple(0 if tail is None else widest - tail for tail in tails)


def column_pads(table: Table) -> list[tuple[int, ...]]:
    """`decimal_pads` of every column, zeros for left-aligned ones; indexed [column][row]."""
    return [
        decimal_pads([row[j] for row in table.rows]) if side == "r" else (0,) * len(table.rows)
        for j, side in enumerate(table.sides)
    ]


@dataclass(frozen=True)
class _Column:
    """Header and cells, on one line each, and the widths that they need."""

    header: str
    cells: tuple[str, ...]
    right: bool

    @property
    def width(self) -> int:
        """Cells of a terminal that the column takes when nothing is folded."""
        return max([1, *map(cell_len, (self.header, *self.cells))])

    @property
    def folded(self) -> int:
        """Cells that it takes when only its header is folded."""
        return max([1, *map(cell_len, (*self.header.split(), *self.cells))])

    @property
    def least(self) -> int:
        """Cells below which the table is rather split: no number is ever cut before that."""
        return self.folded if self.right else min(self.folded, NARROWEST)

    def shown(self, i: int, size: int) -> Line:
        """A number whole, as far right as the digits of its column go; words folded."""
        if not self.right:
            return Line(self.cells[i])
        spare = " " * (size - cell_len(self.cells[i]))
        return Line(spare + self.cells[i], no_wrap=True, overflow="ellipsis")


def grids(table: Table, width: int) -> Iterator[RenderableType]:
    """The table in parts, none wider than `width` cells.

    Columns of text shrink first and fold their words; what is still too wide follows below, with
    the first column repeated.
    """
    columns = [
        _Column(
            one_line(name),
            tuple(one_line(r[j]) + " " * p for r, p in zip(table.rows, pads, strict=True)),
            table.sides[j] == "r",
        )
        for j, (name, pads) in enumerate(zip(table.header, column_pads(table), strict=True))
    ]
    tones = [table.tones.get(i, "plain") for i in range(len(table.rows))]
    signs = any(tone != "plain" for tone in tones)
    width -= 2 * signs
    parts = [columns[:1]]
    for column in columns[1:]:
        if sum(c.least + GAP for c in (*parts[-1], column)) - GAP > width and len(parts[-1]) > 1:
            parts.append(columns[:1])
        parts[-1] = [*parts[-1], column]
    for n, part in enumerate(parts):
        if n:
            yield Line()
        grid = Grid(box=_RULED, show_edge=False, padding=0, border_style="dim")
        if signs:
            grid.add_column("", width=1)
        sizes = _widths(part, width)
        gaps = [GAP - 1] * (len(part) - 1) + [0]  # the box makes the first cell of each
        for column, size, gap in zip(part, sizes, gaps, strict=True):
            name = Line(column.header, "bold", justify="right" if column.right else "left")
            grid.add_column(Padding(name, (0, gap, 0, 0)), width=size + gap, overflow="fold")
        for i, tone in enumerate(tones):
            cells = [
                Padding(c.shown(i, size), (0, gap, 0, 0))
                for c, size, gap in zip(part, sizes, gaps, strict=True)
            ]
            grid.add_row(*[SIGNS[tone] or " "] * signs, *cells, style=STYLES[tone])
        yield grid


def _widths(part: list[_Column], width: int) -> list[int]:
    """Natural widths; where too wide, headers fold first, then texts, then all is cut."""
    widths = [column.width for column in part]
    spare = max(width - GAP * (len(part) - 1), len(part))
    for floors in ([c.folded for c in part], [c.least for c in part], [1] * len(part)):
        while sum(widths) > spare and any(map(int.__gt__, widths, floors)):
            j = max(range(len(part)), key=lambda k: (widths[k] > floors[k], widths[k]))
            widths[j] -= 1
    return widths
