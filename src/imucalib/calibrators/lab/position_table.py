"""Position tables: one row a position, with what was set (two angles, a face or a direction) and,
mostly, raw x, y, z.

Columns are found by name or given; every cell that is used must be a number. Rows are counted from
1 without the heading, as a person counts them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.atomic_file import replaced_atomically
from imucalib.calibrators.lab.headings import ROLES, bare, roles_of, says_something
from imucalib.errors import UnreadableInput, UsageError
from imucalib.readers.csv.table import Cells, and_more, selected, table_cells
from imucalib.readers.csv.text import few_values, is_blank, is_number
from imucalib.readers.devices.catalogue import refuse_foreign
from imucalib.readers.hdf5.reader import table_columns
from imucalib.readers.source import head_of, sha256_of
from imucalib.recording.mapping import FieldMapping
from imucalib.units import DEG

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
_SHOWN = 10  # rows that an error lists


def ranges(rows: Sequence[int]) -> str:
    """Row numbers in order as "1-4, 7"."""
    cut = np.flatnonzero(np.diff(rows) != 1) + 1
    parts = np.split(np.asarray(rows), cut)
    return ", ".join(f"{p[0]}-{p[-1]}" if len(p) > 1 else f"{p[0]}" for p in parts)


@dataclass(frozen=True)
class PositionTable:
    """Columns by role, each (n,), as numbers in the table's own units.

    unit : role -> unit that the heading states, when it does; inclination_zero : the same of
    where inclination 0 is, "vertical" or "horizontal"
    names : role -> heading; row : (n,) row numbers from 1; sha256 : of the file, of several of
    their sums; files : the sum of each of several
    sessions : names of the power-ups, which the column session counts from 0, in order
    others : the columns that take no part, as they stand in the file
    rows : that the file has, of which some may not be here; notes : what was left out, and why
    upright : rows (from 1) whose tool-face is blank at the vertical, where it is none
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
    rows: int = 0
    notes: tuple[str, ...] = ()
    upright: tuple[int, ...] = ()

    def __contains__(self, role: object) -> bool:
        return role in self.columns

    @property
    def n(self) -> int:
        return len(self.row)

    @property
    def once(self) -> PositionTable:
        """Without rows that repeat another to the last digit in all that takes part: such a row was
        pasted, not measured again."""
        whole = np.column_stack([self.columns[role] for role in sorted(self.columns)])
        _, first = np.unique(whole, axis=0, return_index=True)
        if len(first) == len(whole):
            return self
        keep = np.sort(first)
        gone = np.setdiff1d(self.row, self.row[keep])
        said = f"{len(gone)} rows repeat others to the last digit and count once: "
        return replace(
            self,
            columns={role: values[keep] for role, values in self.columns.items()},
            row=self.row[keep],
            others={n: [v[k] for k in keep] for n, v in self.others.items()},
            notes=(*self.notes, said + ranges(gone.tolist())),
        )

    def demand(self, row: int, option: str) -> None:
        """Raise UsageError for a row that is not here."""
        if row not in self.row:
            last = max(self.rows, int(self.row.max()))
            what = f"row {row} takes no part" if 1 <= row <= last else f"there is no row {row}"
            raise UsageError(f"{option}: {what}", remedy=f"rows are 1..{last}")

    def at(self, row: int) -> int:
        """Where a row of the file stands: elsewhere once the rows are in the order of time."""
        return int(np.flatnonzero(self.row == row)[0])

    @cached_property
    def unused(self) -> tuple[str, ...]:
        """Headings of columns of numbers that take no part."""
        return tuple(name for name, cells in self.others.items() if says_something(cells))

    @property
    def left_out(self) -> tuple[str, ...]:
        """What is said of rows and columns that take no part."""
        words = (few_values(name, [str(c) for c in cells]) for name, cells in self.others.items())
        said = (*self.notes, *filter(None, words))
        if not self.unused:
            return said
        hint = f"--columns driver={self.unused[0]} looks whether it drives what is left"
        return (*said, f"columns that take no part: {', '.join(self.unused)} ({hint})")

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
    exclude: Collection[int] = (),
    vertical: tuple[float, ...] = (90.0, -90.0),
) -> PositionTable:
    """Read a CSV, HDF5 or XLSX table.

    chosen : role (or "face") -> heading, overriding what is found by name
    mapping : of a CSV, lines to skip, delimiter, decimal mark and conditions on rows
    exclude : rows (from 1) that may hold anything; those that cannot be read are left out
    vertical : inclinations (deg) at which the tool-face, which is none there, may be blank
    Raises UnreadableInput (missing or non-numeric cells, with row and column; no file) and
    UsageError (an unknown role or heading in `chosen`).
    """
    where = str(path)
    cells = _cells_of(path, mapping or FieldMapping(), exclude)
    wanted, every = dict(chosen or {}), list(cells.columns)
    face = _face_heading(every, wanted.pop("face", ""), where) if need_direction else ""
    names = roles_of(every, wanted, where)
    if not need_raw:  # of a plan they are still to be filled in
        names = {role: name for role, name in names.items() if role not in "xyz"}
    required = ("inclination", "tool_face") * need_angles + ("x", "y", "z") * need_raw
    _demand((*required, *("ux", "uy", "uz") * need_direction * (not face)), names, every, where)
    cells, names, notes, upright = _read(
        cells, names, (*required, *wanted), exclude, vertical, where
    )
    numbers = {role: name for role, name in names.items() if role != "session"}
    columns = {role: _numbers(cells.columns[name]) for role, name in numbers.items()}
    for at in upright:
        columns["tool_face"][cells.row.index(at)] = 0.0  # any angle is the same direction there
    sessions: tuple[str, ...] = ()
    if "session" in names:
        sessions, columns["session"] = _sessions(
            cells.columns[names["session"]], names["session"], path
        )
    if face:
        columns |= _directions(cells, face, where)
        names["face"] = face
    stated = {role: bare(name) for role, name in names.items()}
    unit = {role: heading.unit for role, heading in stated.items() if heading.unit}
    zero = stated["inclination"].zero if "inclination" in stated else ""
    others = {n: values for n, values in cells.columns.items() if n not in names.values()}
    return PositionTable(
        columns,
        names,
        unit,
        np.array(cells.row, np.intp),
        path=where,
        sha256=sha256_of(path),
        inclination_zero=zero,
        sessions=sessions,
        others=others,
        rows=cells.file_rows,
        notes=(*cells.notes, *notes),
        upright=upright,
    )


def roles_in(path: Path, mapping: FieldMapping) -> set[str]:
    """What the columns of a file are, by their headings. Errors as in `read_position_table`."""
    return set(roles_of(list(_cells_of(path, mapping, ()).columns), {}, str(path)))


def _cells_of(path: Path, mapping: FieldMapping, exclude: Collection[int]) -> Cells:
    if not path.is_file():
        raise UnreadableInput("no such file", where=str(path), remedy="check the path")
    head = head_of(path)
    refuse_foreign(path, head)
    if head.startswith(_HDF5):
        columns = table_columns(path)
        count = len(next(iter(columns.values()), ()))
        return selected(Cells(columns, tuple(range(1, count + 1)), count), mapping, str(path))
    return table_cells(path, mapping, exclude)


def _read(
    cells: Cells,
    names: dict[str, str],
    required: Collection[str],
    exclude: Collection[int],
    vertical: tuple[float, ...],
    where: str,
) -> tuple[Cells, dict[str, str], list[str], tuple[int, ...]]:
    """The rows whose cells are numbers, the roles that can be read, what was left out, and the rows
    whose tool-face is blank at the vertical.

    Raises UnreadableInput that lists all cells of required roles that are no numbers.
    """
    found = {role: _numbers(cells.columns[n]) for role, n in names.items() if role != "session"}
    upright = _upright(cells, names, found, vertical)
    bad = {role: ~np.isfinite(values) for role, values in found.items()}
    if "tool_face" in bad:
        bad["tool_face"] &= ~np.isin(cells.row, upright)
    asked = np.isin(cells.row, list(exclude))
    needed = [role for role in bad if role in required]
    out = asked & np.any([bad[role] for role in needed], axis=0) if needed else ~asked & False
    _demand_numbers(cells, names, {role: bad[role] & ~out for role in needed}, where)
    notes, kept = list[str](), dict(names)
    for role in set(bad) - set(needed):
        if (bad[role] & ~out).any():
            at = int(np.argmax(bad[role] & ~out))
            cell = cells.columns[names[role]][at]
            notes.append(
                f"column '{names[role]}' left out: row {cells.row[at]} "
                + (f"holds '{cell}'" if str(cell) else "is empty")
            )
            del kept[role]
    if out.any():
        gone = ", ".join(str(cells.row[k]) for k in np.flatnonzero(out))
        notes.append(f"excluded as asked, and not readable: row {gone}")
    if upright:
        rows = ", ".join(map(str, upright))
        notes.append(f"the tool-face is blank at the vertical, where it is none: row {rows}")
    return cells.at(np.flatnonzero(~out).tolist()), kept, notes, upright


def _upright(
    cells: Cells, names: Mapping[str, str], found: Mapping[str, Array], vertical: tuple[float, ...]
) -> tuple[int, ...]:
    """Rows whose tool-face is blank where the inclination says that the tool is vertical."""
    if not {"inclination", "tool_face"} <= found.keys():
        return ()
    heading = bare(names["inclination"])
    stated = {"vertical": (0.0, 180.0), "horizontal": (90.0, -90.0)}.get(heading.zero, vertical)
    angles = found["inclination"] / (DEG if heading.unit == "rad" else 1.0)
    # An angle in rad has as many digits as its writer gave it.
    there = np.isclose(angles[:, None], stated, atol=1e-3).any(axis=1)
    blank = [is_blank(str(c).strip()) for c in cells.columns[names["tool_face"]]]
    return tuple(cells.row[k] for k in np.flatnonzero(there & np.array(blank)))


def _demand_numbers(
    cells: Cells, names: Mapping[str, str], bad: Mapping[str, NDArray[np.bool_]], where: str
) -> None:
    places = [(int(k), role) for role, wrong in bad.items() for k in np.flatnonzero(wrong)]
    if not places:
        return
    places.sort(key=lambda place: place[0])
    said = []
    for k, role in places:
        cell = str(cells.columns[names[role]][k])
        said.append(
            (
                f"row {cells.row[k]}, column {names[role]}",
                f"'{cell}' is not a number" if cell else "the cell is empty",
            )
        )
    rows = list(dict.fromkeys(cells.row[k] for k, _ in places))
    more = and_more([f"{at}" for at, _ in said[1:]])
    shown = ",".join(map(str, rows[:_SHOWN]))
    raise UnreadableInput(
        said[0][1] + more,
        where=f"{where}, {said[0][0]}",
        remedy=f"correct {'the cell' if len(said) == 1 else 'the cells'}, or leave "
        f"{'the row' if len(rows) == 1 else 'the rows'} out of the table (lab: --exclude {shown})",
    )


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


def _demand(roles: tuple[str, ...], found: Mapping[str, str], have: list[str], where: str) -> None:
    absent = [role for role in roles if role not in found]
    if not absent:
        return
    remedy = f"name it: --columns {','.join(f'{role}=HEADING' for role in absent)}"
    if set("xyz") <= set(absent):
        remedy += "; or give the log of rests in these positions: --recording LOG"
    elif {"inclination", "tool_face"} <= set(absent):
        remedy += "; or, without known angles, add --reference norm"
    if "inclination" in absent and any(h.strip().lower() in _FACE_NAMES for h in have):
        remedy = "add --reference direction where faces stand for angles"
    if "ux" in absent:
        remedy = "add a column face with +x, -x, +y, -y, +z or -z, or name it: --columns face=B"
    raise UnreadableInput(
        f"no column for {', '.join(absent)} among: {', '.join(have)}", where=where, remedy=remedy
    )


def _numbers(cells: Array | list[str]) -> Array:
    """The cells as numbers, NaN where they are none."""
    if not isinstance(cells, list):
        return np.array(cells, dtype=np.float64)
    return np.array([float(c) if is_number(c) else np.nan for c in cells])


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


def _directions(cells: Cells, name: str, where: str) -> dict[str, Array]:
    """ux, uy, uz of faces by name."""
    found = np.zeros((len(cells.row), 3))
    for k, cell in enumerate(cells.columns[name]):
        text = str(cell).lower().replace("\u2212", "-")
        text = text[::-1] if text[-1:] in ("+", "-") else text  # a spreadsheet takes "+x" for a sum
        if text not in _FACES:
            raise UnreadableInput(
                f"'{cell}' is no face" if str(cell) else "the cell is empty",
                where=f"{where}, row {cells.row[k]}, column {name}",
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
