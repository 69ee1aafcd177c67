"""Repairs of a position table as the user states them: the lines that `imucal lab` proposes.

They are applied in a fixed order: angle columns exchanged, unit of angles, axes (of the whole
table, then of parts), shifts, moves, exchanges, cells. Rows keep their numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Index
from imucalib.calibrators.lab.bench import corrected_cells, swapped_angles
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.errors import UsageError

_ANGLES = ("inclination", "tool_face")
#: What was set and not read: it stays where it stands when readings move.
_SET = (*_ANGLES, "ux", "uy", "uz")


@dataclass(frozen=True)
class Shift:
    """Values of a column that belong `step` rows farther down, within rows first to last.

    what : "readings", "inclination" or "tool_face"; first, last : from 1, 0 for the whole table
    """

    what: str
    first: int
    last: int
    step: int


@dataclass(frozen=True)
class Part:
    """Rows first to last, and the columns that are the sensor's x, y, z in them."""

    first: int
    last: int
    axes: tuple[str, ...]


@dataclass(frozen=True)
class Repairs:
    """swaps : pairs of rows whose readings are exchanged; moves : (row, row to which its reading
    belongs); axes : the columns that are the sensor's x, y, z, as ("-y", "x", "z"), () for as they
    stand; radians : the angle columns are in rad; parts : where the axes are others. Rows count
    from 1."""

    swaps: tuple[tuple[int, int], ...] = ()
    moves: tuple[tuple[int, int], ...] = ()
    shifts: tuple[Shift, ...] = ()
    axes: tuple[str, ...] = ()
    radians: bool = False
    parts: tuple[Part, ...] = ()


def repairs_of(
    swaps: tuple[str, ...],
    moves: tuple[str, ...],
    shifts: tuple[str, ...],
    axes: tuple[str, ...],
    angle_unit: str | None,
) -> Repairs:
    """Repairs from the texts of the options. Raises UsageError with an example."""
    return Repairs(
        tuple(_pair(text, "--swap") for text in swaps),
        tuple(_pair(text, "--move") for text in moves),
        tuple(_shift(text) for text in shifts),
        _whole_axes([text for text in axes if ":" not in text]),
        angle_unit == "rad",
        tuple(_part(text) for text in axes if ":" in text),
    )


def _pair(text: str, option: str) -> tuple[int, int]:
    try:
        first, second = (int(part) for part in text.split(","))
    except ValueError:
        raise UsageError(f"{option} {text}: not two rows", remedy=f"{option} 3,10") from None
    return first, second


def _shift(text: str) -> Shift:
    name, sign, step = text.partition("=")
    what, _, rows = name.partition(":")
    try:
        if what not in ("readings", *_ANGLES) or not sign or int(step) not in (-1, 1):
            raise ValueError
        first, last = (int(part) for part in rows.split("-")) if rows else (0, 0)
    except ValueError:
        raise UsageError(
            f"--shift {text}: not COLUMN[:ROWS]=STEP",
            remedy="--shift readings:5-12=-1 or --shift inclination=1; the step is 1 or -1",
        ) from None
    return Shift(what, first, last, int(step))


def _whole_axes(texts: list[str]) -> tuple[str, ...]:
    if len(texts) > 1:
        raise UsageError(
            f"--axes {' and '.join(texts)}: once for the whole table",
            remedy="name the rows of a part: --axes=17-32:-y,x,z",
        )
    return _axes(texts[0]) if texts else ()


def _part(text: str) -> Part:
    rows, _, axes = text.partition(":")
    try:
        first, last = (int(part) for part in rows.split("-"))
    except ValueError:
        raise UsageError(f"--axes {text}: not ROWS:x,y,z", remedy="--axes=17-32:-y,x,z") from None
    return Part(first, last, _axes(axes))


def _axes(text: str) -> tuple[str, ...]:
    parts = tuple(part.strip().removeprefix("+") for part in text.split(","))
    if sorted(part.removeprefix("-") for part in parts) != ["x", "y", "z"]:
        raise UsageError(f"--axes {text}: not x, y and z once each", remedy="--axes=-y,x,z")
    return parts


def repaired(
    table: PositionTable,
    repairs: Repairs,
    fixes: tuple[tuple[int, str, float], ...],
    swap_angles: bool,
) -> tuple[PositionTable, tuple[int, ...]]:
    """The table as the user says it should be, and the rows (from 1) that a shift left without a
    value. Raises UsageError for rows and columns that do not exist."""
    table = swapped_angles(table) if swap_angles else table
    if repairs.radians:
        table = replace(table, unit={**table.unit, **dict.fromkeys(_ANGLES, "rad")})
    if repairs.axes:
        table = _turned(table, np.arange(table.n), repairs.axes)
    for part in repairs.parts:
        ends = _rows(table, (part.first, part.last), "--axes")
        table = _turned(table, np.arange(min(ends), max(ends) + 1), part.axes)
    lost: list[int] = []
    for shift in repairs.shifts:
        first, last = (shift.first, shift.last) if shift.first else (table.row[0], table.row[-1])
        order = np.arange(table.n)
        rows = _rows(table, (first, last), "--shift")
        inside = np.arange(min(rows), max(rows) + 1)
        order[inside] = np.roll(inside, shift.step)
        lost.append(int(table.row[inside[0] if shift.step > 0 else inside[-1]]))
        table = _reordered(table, order, shift.what)
    for at, to in repairs.moves:
        a, b = _rows(table, (at, to), "--move")
        order = np.insert(np.delete(np.arange(table.n), a), b, a)
        table = _reordered(table, order, "readings")
    for pair in repairs.swaps:
        a, b = _rows(table, pair, "--swap")
        order = np.arange(table.n)
        order[[a, b]] = order[[b, a]]
        table = _reordered(table, order, "readings")
    return corrected_cells(table, fixes), tuple(lost)


def _turned(table: PositionTable, rows: Index, axes: tuple[str, ...]) -> PositionTable:
    """Some rows with other columns as the sensor's x, y, z."""
    turned = {}
    for axis, part in zip("xyz", axes, strict=True):
        turned[axis] = table.columns[axis].copy()
        sign = -1.0 if part.startswith("-") else 1.0
        turned[axis][rows] = sign * table.columns[part.removeprefix("-")][rows]
    return replace(table, columns={**table.columns, **turned})


def _rows(table: PositionTable, rows: tuple[int, int], option: str) -> tuple[int, int]:
    """Where two rows of the file stand; UsageError for one that does not exist."""
    for row in rows:
        table.demand(row, option)
    return table.at(rows[0]), table.at(rows[1])


def _reordered(table: PositionTable, order: Index, what: str) -> PositionTable:
    """One angle's column, or all that was read (not set), in another order."""
    moves = {
        role: values[order]
        for role, values in table.columns.items()
        if (role == what if what != "readings" else not role.startswith(_SET))
    }
    if not moves:
        raise UsageError(
            f"--shift {what}: no such column", remedy=f"there are: {list(table.names)}"
        )
    return replace(table, columns={**table.columns, **moves})
