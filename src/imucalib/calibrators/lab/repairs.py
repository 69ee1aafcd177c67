"""Repairs of a position table as the user states them: the lines that `imucal lab` proposes.

They are applied in a fixed order: angle columns exchanged, unit of angles, axes (of the whole
table, then of parts), shifts, moves, exchanges, cells. Rows keep their numbers.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Index
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.errors import UsageError

_ANGLES = ("inclination", "tool_face")
#: What was set and not read: it stays where it is when readings move.
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
class SheetPart:
    """Rows first to last, and the columns that are the sensor's x, y, z in them."""

    first: int
    last: int
    axes: tuple[str, ...]


@dataclass(frozen=True)
class Repairs:
    """swaps : pairs of rows whose readings are exchanged; moves : (row, row to which its reading
    belongs); axes : the columns that are the sensor's x, y, z, as ("-y", "x", "z"), () for as they
    are; radians : the angle columns are in rad; parts : where the axes are others. Rows count
    from 1."""

    swaps: tuple[tuple[int, int], ...] = ()
    moves: tuple[tuple[int, int], ...] = ()
    shifts: tuple[Shift, ...] = ()
    axes: tuple[str, ...] = ()
    radians: bool = False
    parts: tuple[SheetPart, ...] = ()


def repairs_of(
    swaps: tuple[str, ...],
    moves: tuple[str, ...],
    shifts: tuple[str, ...],
    axes: tuple[str, ...],
    angle_unit: str | None,
) -> Repairs:
    """Repairs from the texts of the options. Raises UsageError with an example."""
    whole = [text for text in axes if ":" not in text]
    if len(whole) > 1:
        raise UsageError(
            f"--axes {' and '.join(whole)}: once for the whole table",
            remedy="name the rows of a part: --axes=17-32:-y,x,z",
        )
    return Repairs(
        swaps=tuple(_pair(text, "--swap") for text in swaps),
        moves=tuple(_pair(text, "--move") for text in moves),
        shifts=tuple(_shift(text) for text in shifts),
        axes=_axes(whole[0]) if whole else (),
        radians=angle_unit == "rad",
        parts=tuple(_part(text) for text in axes if ":" in text),
    )


def _match_groups(pattern: str, option: str, text: str, refusal: str, remedy: str) -> Sequence[str]:
    """The groups of a text without spaces. Raises UsageError where it is none of the pattern."""
    found = re.fullmatch(pattern, re.sub(r"\s", "", text))
    if found is None:
        raise UsageError(f"{option} {text}: {refusal}", remedy=remedy)
    return found.groups(default="0")


def _pair(text: str, option: str) -> tuple[int, int]:
    first, second = _match_groups(
        r"(\d+),(\d+)", option, text, "not two rows", f"for example {option} 3,10"
    )
    return int(first), int(second)


def _shift(text: str) -> Shift:
    what, first, last, step = _match_groups(
        r"(readings|inclination|tool_face)(?::(\d+)-(\d+))?=([+-]?1)",
        "--shift",
        text,
        "not COLUMN[:ROWS]=STEP",
        "for example --shift readings:5-12=-1 or --shift inclination=1; the step is 1 or -1",
    )
    return Shift(what, int(first), int(last), int(step))


def _part(text: str) -> SheetPart:
    first, last, axes = _match_groups(
        r"(\d+)-(\d+):(.*)", "--axes", text, "not ROWS:x,y,z", "for example --axes=17-32:-y,x,z"
    )
    return SheetPart(int(first), int(last), _axes(axes))


def _axes(text: str) -> tuple[str, ...]:
    parts = tuple(part.strip().removeprefix("+") for part in text.split(","))
    if sorted(part.removeprefix("-") for part in parts) != ["x", "y", "z"]:
        raise UsageError(
            f"--axes {text}: not x, y and z once each", remedy="for example --axes=-y,x,z"
        )
    return parts


def repair(
    table: PositionTable,
    repairs: Repairs,
    fixes: tuple[tuple[int, str, float], ...],
    swap_angles: bool,
) -> tuple[PositionTable, tuple[int, ...]]:
    """The table as the user says it should be, and the rows (from 1) that a shift emptied. Raises
    UsageError for rows and columns that do not exist."""
    if swap_angles:
        exchanged = dict(zip(_ANGLES, (table.columns[role] for role in _ANGLES[::-1]), strict=True))
        table = replace(table, columns={**table.columns, **exchanged})
    if repairs.radians:
        table = replace(table, unit={**table.unit, **dict.fromkeys(_ANGLES, "rad")})
    if repairs.axes:
        table = _turn_columns(table, np.arange(table.n), repairs.axes)
    for part in repairs.parts:
        ends = _places(table, (part.first, part.last), "--axes")
        table = _turn_columns(table, np.arange(min(ends), max(ends) + 1), part.axes)
    empty: list[int] = []
    every = np.arange(table.n)
    for shift in repairs.shifts:
        whole = (int(table.row[0]), int(table.row[-1]))
        ends = _places(table, (shift.first, shift.last) if shift.first else whole, "--shift")
        inside, order = np.arange(min(ends), max(ends) + 1), every.copy()
        order[inside] = np.roll(inside, shift.step)
        empty.append(int(table.row[inside[0] if shift.step > 0 else inside[-1]]))
        table = _reorder(table, order, shift.what)
    for pair in repairs.moves:
        a, b = _places(table, pair, "--move")
        table = _reorder(table, np.insert(np.delete(every, a), b, a), "readings")
    for pair in repairs.swaps:
        a, b = _places(table, pair, "--swap")
        order = every.copy()
        order[[a, b]] = b, a
        table = _reorder(table, order, "readings")
    return _add_cells(table, fixes), tuple(empty)


def _turn_columns(table: PositionTable, rows: Index, axes: tuple[str, ...]) -> PositionTable:
    """Some rows with other columns as the sensor's x, y, z."""
    turned = {}
    for axis, part in zip("xyz", axes, strict=True):
        turned[axis] = table.columns[axis].copy()
        sign = -1.0 if part.startswith("-") else 1.0
        turned[axis][rows] = sign * table.columns[part.removeprefix("-")][rows]
    return replace(table, columns={**table.columns, **turned})


def _places(table: PositionTable, rows: tuple[int, int], option: str) -> tuple[int, int]:
    """Where two rows of the file are; UsageError for one that does not exist."""
    for row in rows:
        table.demand(row, option)
    return table.at(rows[0]), table.at(rows[1])


def _reorder(table: PositionTable, order: Index, what: str) -> PositionTable:
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


def _add_cells(table: PositionTable, fixes: tuple[tuple[int, str, float], ...]) -> PositionTable:
    """The table with single cells replaced, as the user asked; rows count from 1."""
    columns = {role: values.copy() for role, values in table.columns.items()}
    for row, role, value in fixes:
        if role not in columns or row not in table.row:
            raise UsageError(
                f"--fix {row}:{role}: no such cell",
                remedy=f"rows are 1..{max(table.rows, table.n)}, columns {', '.join(columns)}",
            )
        columns[role][table.at(row)] = value
    return replace(table, columns=columns)
