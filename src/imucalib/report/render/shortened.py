"""Tables cut to what a page of the terminal has room for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from imucalib.report.document import Section, Table

#: Rows of a table that stay, however little room there is.
LEAST = 3


def shortened(
    sections: Sequence[Section], room: int, length: Callable[[Section], int]
) -> tuple[Section, ...]:
    """The sections with as many rows of each table as fit into `room` lines together.

    length : lines of a section. Rows that a reader must not miss stay first.
    """
    low, high = LEAST, max((len(t.rows) for s in sections for t in _tables(s)), default=LEAST)
    if sum(map(length, sections)) <= room:
        return tuple(sections)
    while low < high:
        rows = (low + high + 1) // 2
        if sum(length(_cut(section, rows)) for section in sections) <= room:
            low = rows
        else:
            high = rows - 1
    return tuple(_cut(section, low) for section in sections)


def _tables(section: Section) -> list[Table]:
    return [block for block in section.blocks if isinstance(block, Table)]


def _cut(section: Section, rows: int) -> Section:
    blocks = (_first(b, rows) if isinstance(b, Table) else b for b in section.blocks)
    return replace(section, blocks=tuple(blocks))


def _first(table: Table, rows: int) -> Table:
    """The toned rows and the first of the others, in their order."""
    left = len(table.rows) - rows
    if left <= 0:
        return table
    toned = [i for i in range(len(table.rows)) if table.tones.get(i, "plain") in ("bad", "warning")]
    others = [i for i in range(len(table.rows)) if i not in set(toned)]
    kept = sorted([*toned, *others][:rows])
    return replace(
        table,
        rows=tuple(table.rows[i] for i in kept),
        tones={n: table.tones[i] for n, i in enumerate(kept) if i in table.tones},
        note=f"{left} more rows: --full. {table.note}".rstrip(),
    )
