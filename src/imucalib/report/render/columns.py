"""Decimal points of a table column brought under each other, whatever the digits of each row."""

from __future__ import annotations

import re
from collections.abc import Sequence

from imucalib.report.document import Table

_NUMBER = re.compile(r"[<>≤≥~±+\-−]*\s?\d[\d,   ]*(?:\.(?P<decimals>[\d   ]*))?(?P<tail>.*)")
_ABSENT = frozenset({"", "-", "–", "—", "n/a"})
MOST = 8  # a wider pad would cost more room than the alignment gives back


def decimal_pads(cells: Sequence[str]) -> tuple[int, ...]:
    """Characters to add after each cell so that decimal points align; zeros for mixed content.

    Cells with a tail of their own, such as an exponent or a unit, are left as they are.
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


def squared(table: Table) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...], str]:
    """Header, rows and alignment, all of one number of columns (short rows get empty cells)."""
    n = max([len(table.header), *(len(row) for row in table.rows)])
    rows = tuple((*row, *[""] * (n - len(row))) for row in table.rows)
    header = (*table.header, *[""] * (n - len(table.header)))
    return header, rows, table.align.ljust(n, "l")[:n]


def column_pads(table: Table) -> list[tuple[int, ...]]:
    """`decimal_pads` of every column, zeros for left-aligned ones; indexed [column][row]."""
    _, rows, align = squared(table)
    columns = [[row[j] for row in rows] for j in range(len(align))]
    return [
        decimal_pads(cells) if side == "r" else (0,) * len(cells)
        for cells, side in zip(columns, align, strict=True)
    ]
