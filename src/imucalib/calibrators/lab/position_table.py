"""Position tables: one row a position, with what was set (two angles, a face or a direction) and,
mostly, raw x, y, z.

Columns are found by name or given; every cell that is used must be a number. Rows are counted from
1 without the heading, as a person counts them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.atomic_file import replaced_atomically
from imucalib.calibrators.lab.headings import ROLES, bare, roles_of, says_something
from imucalib.errors import UnreadableInput, UsageError
from imucalib.readers.csv.dialect import is_number
from imucalib.readers.csv.spreadsheet import is_spreadsheet, sheet_cells
from imucalib.readers.csv.table import table_cells
from imucalib.readers.hdf5.table import table_columns
from imucalib.readers.source import head_of, sha256_of
from imucalib.recording.mapping import FieldMapping

#: A column of words stands for the direction ux, uy, uz: the axis that reads +g in the position.
_FACE_NAMES = ("face", "up", "face_up", "face up")
_FACES = tuple(f"{sign}{letter}" for sign in "+-" for letter in "xyz")
#: Rows that sessions have on average, at least.
_OF_A_SESSION = 3
_HDF5 = b"\x89HDF\r\n\x1a\n"
#: A file of positions has at most this many rows; a longer one is taken for a recording.
_MOST = 2000
#: From one position to the next readings change by more than this share of gravity (samples at rest
#: do not), or stated seconds pass.
_TURNED, _PASSED = 0.05, 1.0


@dataclass(frozen=True)
class PositionTable:
    """Columns by role, each (n,), as numbers in the table's own units.

    unit : role -> unit that the heading states, when it does; inclination_zero : the same of
    where inclination 0 is, "vertical" or "horizontal"
    names : role -> heading; row : (n,) row numbers from 1; sha256 : of the file, of several of
    their sums; files : the sum of each of several
    sessions : names of the power-ups, which the column session counts from 0, in order
    others : the columns that take no part, as they stand in the file
    """

    columns: Mapping[str, Array]
    names: Mapping[str, str]
    unit: Mapping[str, str]
    row: NDArray[np.intp]
    path: str
    sha256: str
    inclination_zero: str = ""
    sessions: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    others: Mapping[str, Array | list[str]] = field(default_factory=dict)

    def __contains__(self, role: object) -> bool:
        return role in self.columns

    @property
    def n(self) -> int:
        return len(self.row)

    def at(self, row: int) -> int:
        """Where a row of the file stands: elsewhere once the rows are in the order of time."""
        return int(np.flatnonzero(self.row == row)[0])

    @cached_property
    def unused(self) -> tuple[str, ...]:
        """Headings of columns of numbers that take no part."""
        return tuple(name for name, cells in self.others.items() if says_something(cells))

    @property
    def left_out(self) -> tuple[str, ...]:
        """What is said of columns that take no part."""
        if not self.unused:
            return ()
        hint = f"--columns driver={self.unused[0]} looks whether it drives what is left"
        return (f"columns that take no part: {', '.join(self.unused)} ({hint})",)

    @property
    def by_time(self) -> PositionTable:
        """The rows in the order of their time column, or as they stand where there is none."""
        order = np.argsort(self.columns["time"], kind="stable") if "time" in self else slice(None)
        columns = {role: values[order] for role, values in self.columns.items()}
        return replace(self, columns=columns, row=self.row[order])

    @property
    def of_positions(self) -> bool:
        """Whether the rows are positions held still, not the samples of a recording in time."""
        if self.n > _MOST or "time" not in self or self.n < 2:
            return self.n <= _MOST
        inside = self.by_time
        if self.unit.get("time") == "s" and np.median(np.diff(inside.columns["time"])) >= _PASSED:
            return True
        turned = np.linalg.norm(np.diff(inside.raw(), axis=0), axis=1)
        usual = float(np.median(np.linalg.norm(inside.raw(), axis=1)))
        return float(np.median(turned)) > _TURNED * usual

    def raw(self) -> Array:
        """(n, 3) raw readings."""
        return np.stack([self.columns[a] for a in "xyz"], axis=-1)


def read_position_table(
    path: Path,
    chosen: Mapping[str, str] | None = None,
    *,
    need_raw: bool = True,
    need_angles: bool = True,
    need_direction: bool = False,
    mapping: FieldMapping | None = None,
) -> PositionTable:
    """Read a CSV, HDF5 or XLSX table.

    chosen : role (or "face") -> heading, overriding what is found by name
    mapping : of a CSV, lines to skip, delimiter and decimal mark
    Raises UnreadableInput (missing or non-numeric cells, with row and column; no file) and
    UsageError (an unknown role or heading in `chosen`).
    """
    if not path.is_file():
        raise UnreadableInput("no such file", where=str(path), remedy="check the path")
    cells: Mapping[str, Array | list[str]]
    if head_of(path).startswith(_HDF5):
        cells = table_columns(path)
    else:
        cells = (sheet_cells if is_spreadsheet(path) else table_cells)(
            path, mapping or FieldMapping()
        )
    wanted = dict(chosen or {})
    face = _face_heading(list(cells), wanted.pop("face", ""), str(path)) if need_direction else ""
    names = roles_of(list(cells), wanted, str(path))
    if not need_raw:  # of a plan they are still to be filled in
        names = {role: name for role, name in names.items() if role not in "xyz"}
    numbers = {role: name for role, name in names.items() if role != "session"}
    columns = {role: _numbers(cells[name], name, str(path)) for role, name in numbers.items()}
    sessions: tuple[str, ...] = ()
    if "session" in names:
        sessions, columns["session"] = _sessions(cells[names["session"]], names["session"], path)
    if face:
        columns |= _directions(cells[face], face, str(path))
        names["face"] = face
    required = ("inclination", "tool_face") * need_angles + ("x", "y", "z") * need_raw
    _demand((*required, *("ux", "uy", "uz") * need_direction), columns, list(cells), str(path))
    stated = {role: bare(name) for role, name in names.items()}
    unit = {role: heading.unit for role, heading in stated.items() if heading.unit}
    zero = stated["inclination"].zero if "inclination" in stated else ""
    row = np.arange(1, len(next(iter(columns.values()))) + 1)
    return PositionTable(
        columns, names, unit, row, path=str(path), sha256=sha256_of(path), inclination_zero=zero,
        sessions=sessions,
        others={name: values for name, values in cells.items() if name not in names.values()},
    )  # fmt: skip


def _sessions(cells: Array | list[str], name: str, path: Path) -> tuple[tuple[str, ...], Array]:
    """Names of sessions in order, and the number of each row's."""
    words = [f"{c:g}" if isinstance(c, float) else str(c).strip() for c in cells]
    if "" in words:
        where = f"{path}, row {words.index('') + 1}, column {name}"
        raise UnreadableInput(
            "the session is empty",
            where=where,
            remedy="name each row's power-up, or drop the column",
        )
    every = list(dict.fromkeys(words))
    if len(every) > 1 and len(words) < _OF_A_SESSION * len(every):
        raise UnreadableInput(
            f"{len(every)} sessions of {len(words)} rows: too few each to tell them apart",
            where=f"{path}, column {name}",
            remedy=f"give each power-up {_OF_A_SESSION} positions or more, or drop the column",
        )
    return tuple(every), np.array([float(every.index(word)) for word in words])


def _demand(
    roles: tuple[str, ...], found: Mapping[str, Array], have: list[str], where: str
) -> None:
    absent = [role for role in roles if role not in found]
    if not absent:
        return
    remedy = f"name it: --columns {','.join(f'{role}=HEADING' for role in absent)}"
    if "inclination" in absent and any(h.strip().lower() in _FACE_NAMES for h in have):
        remedy = "add --reference direction where faces stand for angles"
    if "ux" in absent:
        remedy = "add a column face with +x, -x, +y, -y, +z or -z, or name it: --columns face=B"
    raise UnreadableInput(
        f"no column for {', '.join(absent)} among: {', '.join(have)}", where=where, remedy=remedy
    )


def _numbers(cells: Array | list[str], name: str, where: str) -> Array:
    values = (
        np.array([float(c) if is_number(c) else np.nan for c in cells])
        if isinstance(cells, list)
        else cells
    )
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        cell = str(cells[bad[0]])
        raise UnreadableInput(
            f"'{cell}' is not a number" if cell else "the cell is empty",
            where=f"{where}, row {bad[0] + 1}, column {name}",
            remedy="correct the cell, or leave the row out of the table",
        )
    return values


def _face_heading(headings: list[str], chosen: str, where: str) -> str:
    """The heading of the column of faces, or nothing. Raises as `roles_of` does."""
    hits = [chosen] if chosen else [h for h in headings if h.strip().lower() in _FACE_NAMES]
    if chosen and chosen not in headings:
        raise UsageError(
            f"no column is called '{chosen}'",
            where=where,
            remedy=f"there are: {', '.join(headings)}",
        )
    both = [h for h in headings if h.strip().lower() in ROLES["ux"]] if hits and not chosen else []
    if len(hits) + len(both) > 1:
        raise UnreadableInput(
            f"several columns could be the direction: {', '.join((*hits, *both))}",
            where=where,
            remedy=f"choose one with --columns face={hits[0]}, or rename the others",
        )
    return hits[0] if hits else ""


def _directions(cells: Array | list[str], name: str, where: str) -> dict[str, Array]:
    """ux, uy, uz of faces by name."""
    found = np.zeros((len(cells), 3))
    for k, cell in enumerate(cells):
        text = str(cell).lower().replace("\u2212", "-")
        text = text[::-1] if text[-1:] in ("+", "-") else text  # a spreadsheet takes "+x" for a sum
        if text not in _FACES:
            raise UnreadableInput(
                f"'{cell}' is no face" if str(cell) else "the cell is empty",
                where=f"{where}, row {k + 1}, column {name}",
                remedy="write +x, -x, +y, -y, +z or -z: the axis that points up and reads +g; "
                "or give columns ux, uy, uz",
            )
        found[k, "xyz".index(text[1])] = float(f"{text[0]}1")
    return {role: found[:, axis] for axis, role in enumerate(("ux", "uy", "uz"))}


def write_position_table(table: PositionTable, path: Path, *, angles_only: bool = False) -> None:
    """Write a table as CSV, whole or not at all; `angles_only` leaves the readings out."""
    roles = [r for r in table.columns if not (angles_only and r in ("x", "y", "z"))]
    lines = [",".join(table.names.get(role, role) for role in roles)]
    lines += [",".join(f"{table.columns[role][k]:.10g}" for role in roles) for k in range(table.n)]
    path.parent.mkdir(parents=True, exist_ok=True)
    with replaced_atomically(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")
