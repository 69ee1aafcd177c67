"""Position tables: one row a position, with what was set (two angles, a face or a direction) and,
mostly, raw x, y, z.

Columns are found by name or given; every cell that is used must be a number. Rows are counted from
1 without the heading, as a person counts them.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.atomic_file import replace_atomically
from imucalib.calibrators.lab.headings import ROLES, bare, roles_of, says_something
from imucalib.errors import UnnamedColumns, UnreadableInput, UsageError
from imucalib.file_hash import sha256_of
from imucalib.question import paste
from imucalib.readers.csv.table import Cells, and_more, select_rows, table_cells
from imucalib.readers.csv.text import few_values, is_blank, is_number
from imucalib.readers.devices.catalogue import refuse_foreign
from imucalib.readers.fields.source import head_of
from imucalib.readers.fields.words import triples_of
from imucalib.readers.hdf5.reader import table_columns
from imucalib.recording.identity import NAMELESS, Identity
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.sensors import undecided
from imucalib.units import DEG

#: A column of words stands for the direction ux, uy, uz: the axis that reads +g in the position.
_FACE_NAMES = ("face", "up", "face_up", "face up")
_FACES = tuple(f"{sign}{letter}" for sign in "+-" for letter in "xyz")
#: Inclinations at which the tool-face is none, deg, by where their zero is.
_VERTICAL = {"horizontal": (90.0, -90.0), "vertical": (0.0, 180.0)}
ANGLES, _DIRECTION = {"inclination", "tool_face"}, ("ux", "uy", "uz")
#: Rows that sessions have on average, at least.
_OF_A_SESSION = 3
_HDF5 = b"\x89HDF\r\n\x1a\n"
#: A file of positions has at most this many rows; a longer one is taken for a recording.
_MOST = 2000
#: From one position to the next readings change by more than this share of gravity (samples at rest
#: do not), or stated seconds pass.
_TURNED, _PASSED = 0.05, 1.0
_LARGEST = 1e30  # no sensor, angle or count is as large
_SHOWN = 10  # rows that an error lists
_UNIT = re.compile(r"[\[(][^\[\]()]*[\])]\s*$")


def ranges(rows: Sequence[int] | Index) -> str:
    """Ascending row numbers as "1-4, 7"."""
    parts = np.split(np.asarray(rows), np.flatnonzero(np.diff(rows) != 1) + 1)
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
    sensor : whose readings it has
    upright : rows (from 1) whose tool-face is blank at the vertical, where it is none
    """

    columns: Mapping[str, Array]
    names: Mapping[str, str]
    unit: Mapping[str, str]
    row: Index
    path: str
    sha256: str
    inclination_zero: str = ""
    sessions: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    others: Mapping[str, Array | list[str]] = field(default_factory=dict)
    rows: int = 0
    notes: tuple[str, ...] = ()
    upright: tuple[int, ...] = ()
    sensor: Identity = NAMELESS

    def __contains__(self, role: object) -> bool:
        return role in self.columns

    @property
    def n(self) -> int:
        return len(self.row)

    def raw(self) -> Array:
        """(n, 3) raw readings."""
        return np.stack([self.columns[a] for a in "xyz"], axis=-1)

    def at(self, row: int) -> int:
        """Where a row of the file is: elsewhere once the rows are in the order of time."""
        return int(np.flatnonzero(self.row == row)[0])

    def demand(self, row: int, option: str) -> None:
        """Raise UsageError for a row that is not here."""
        if row not in self.row:
            last = max(self.rows, int(self.row.max()))
            what = f"row {row} takes no part" if 1 <= row <= last else f"there is no row {row}"
            raise UsageError(f"{option}: {what}", remedy=f"rows are 1..{last}")

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
            notes=(*self.notes, said + ranges(gone)),
        )

    @property
    def left_out(self) -> tuple[str, ...]:
        """What is said of rows and columns that take no part."""
        words = (few_values(name, [str(c) for c in cells]) for name, cells in self.others.items())
        said = (*self.notes, *filter(None, words))
        unused = [name for name, cells in self.others.items() if says_something(cells)]
        if not unused:
            return said
        hint = f"{paste('--columns', f'driver={unused[0]}')} looks whether it drives what is left"
        return (*said, f"columns that take no part: {', '.join(unused)} ({hint})")

    @property
    def by_time(self) -> PositionTable:
        """The rows in the order of their time column, or as they are where there is none."""
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
        return inside.turns

    @property
    def turns(self) -> bool:
        """Whether the readings of neighbouring rows differ as positions do."""
        steps = np.linalg.norm(np.diff(self.raw(), axis=0), axis=1)
        usual = float(np.median(np.linalg.norm(self.raw(), axis=1)))
        return bool(len(steps)) and float(np.median(steps)) > _TURNED * usual


def read_position_table(
    path: Path,
    chosen: Mapping[str, str] | None = None,
    *,
    need_raw: bool = True,
    need_angles: bool = True,
    need_direction: bool = False,
    mapping: FieldMapping | None = None,
    exclude: Collection[int] = (),
    zero: str = "horizontal",
    cells: Cells | None = None,
) -> PositionTable:
    """Read a CSV, HDF5 or XLSX table.

    chosen : role (or "face") -> heading, overriding what is found by name
    mapping : the sensor; of a CSV, lines to skip, delimiter, decimal mark, conditions on rows
    exclude : rows (from 1) that may hold anything; those that cannot be read are left out
    zero : where inclination 0 is, unless its heading says; at the vertical the tool-face, which is
        none there, may be blank
    cells : of `cells_of`, where the file was read already
    Raises UnreadableInput (missing or non-numeric cells, with row and column; no file) and
    UsageError (an unknown role or heading in `chosen`).
    """
    cells = cells or cells_of(path, mapping or FieldMapping(), exclude)
    every, where = list(cells.columns), str(path)
    wanted = {**_columns_of(mapping, every, where), **(chosen or {})}
    face = _face_heading(every, wanted.pop("face", ""), where) if need_direction else ""
    names = roles_of(every, wanted, where)
    if not need_raw:  # of a plan they are still to be filled in
        names = {role: name for role, name in names.items() if role not in "xyz"}
    required = ("inclination", "tool_face") * need_angles + ("x", "y", "z") * need_raw
    _demand((*required, *_DIRECTION * (need_direction and not face)), names, every, where)
    columns = {r: _numbers(cells.columns[name]) for r, name in names.items() if r != "session"}
    upright = _upright(cells, names, columns, zero)
    if upright.any():
        columns["tool_face"][upright] = 0.0  # any angle is the same direction there
    bad = {role: ~(np.abs(values) < _LARGEST) for role, values in columns.items()}
    needed = [role for role in bad if role in (*required, *wanted)]
    out = np.isin(cells.row, list(exclude)) & np.any([bad[role] for role in needed], axis=0)
    _demand_numbers(cells, names, {role: bad[role] & ~out for role in needed}, where)
    row = np.array(cells.row, np.intp)
    notes = [*cells.notes, *_drop_unreadable(cells, names, needed, bad, out)]
    if out.any():
        notes.append(f"excluded as asked, and not readable: row {_list_rows(row[out])}")
    if upright.any():
        blank = "the tool-face is blank at the vertical, where it is none: row "
        notes.append(blank + _list_rows(row[upright]))
    cells = cells.at(np.flatnonzero(~out).tolist())
    columns = {role: values[~out] for role, values in columns.items() if role in names}
    sessions: tuple[str, ...] = ()
    if "session" in names:
        sessions, columns["session"] = _sessions(cells, names["session"], path)
    if face:
        columns |= _directions(cells, face, where)
        names["face"] = face
    stated = {role: bare(name) for role, name in names.items()}
    return PositionTable(
        columns,
        names,
        {role: heading.unit for role, heading in stated.items() if heading.unit},
        row[~out],
        path=where,
        sha256=sha256_of(path),
        inclination_zero=stated["inclination"].zero if "inclination" in stated else "",
        sessions=sessions,
        others={n: values for n, values in cells.columns.items() if n not in names.values()},
        rows=cells.file_rows,
        notes=tuple(notes),
        upright=tuple(row[upright & ~out].tolist()),
        sensor=Identity(name=mapping.sensor if mapping else ""),
    )


def cells_of(
    path: Path, mapping: FieldMapping, exclude: Collection[int] = (), most: int = 0
) -> Cells:
    """The cells of a CSV, HDF5 or XLSX table. most : rows after which no more are read, all where
    it is 0. Errors as in `read_position_table`."""
    if not path.is_file():
        raise UnreadableInput("no such file", where=str(path), remedy="check the path")
    head = head_of(path)
    refuse_foreign(path, head)
    if head.startswith(_HDF5):
        columns = table_columns(path, most)
        count = len(next(iter(columns.values()), ()))
        return select_rows(Cells(columns, tuple(range(1, count + 1)), count), mapping, str(path))
    return table_cells(path, mapping, exclude, most)


def cells_of_positions(path: Path, mapping: FieldMapping) -> Cells | None:
    """The cells of what may be a table of positions; None of a file that is longer than one, where
    no heading says that it is. Errors as in `read_position_table`."""
    cells = cells_of(path, mapping, most=_MOST + 1)
    if cells.file_rows <= _MOST:
        return cells
    names = list(cells.columns)
    roles = set(roles_of(names, {}, str(path)))
    stated = roles >= ANGLES or roles >= set(_DIRECTION) or _face_heading(names, "", str(path))
    return cells_of(path, mapping) if stated else None


def _drop_unreadable(
    cells: Cells,
    names: dict[str, str],
    needed: Collection[str],
    bad: Mapping[str, Flags],
    out: Flags,
) -> Iterator[str]:
    """Take roles that are not needed out of the names where a cell is no number, and say which."""
    for role, wrong in bad.items():
        if role not in needed and (wrong & ~out).any():
            at = int(np.argmax(wrong & ~out))
            cell = str(cells.columns[names[role]][at])
            what = f"holds '{cell}'" if cell else "is empty"
            yield f"column '{names.pop(role)}' left out: row {cells.row[at]} {what}"


def _list_rows(rows: Index) -> str:
    return ", ".join(map(str, rows))


def _upright(
    cells: Cells, names: Mapping[str, str], found: Mapping[str, Array], zero: str
) -> Flags:
    """(n,) rows whose tool-face is blank where the inclination says that the tool is vertical."""
    if not {"inclination", "tool_face"} <= found.keys():
        return np.zeros(len(cells.row), np.bool_)
    heading = bare(names["inclination"])
    angles = found["inclination"] / (DEG if heading.unit == "rad" else 1.0)
    # An angle in rad has as many digits as its writer gave it.
    there = np.isclose(angles[:, None], _VERTICAL[heading.zero or zero], atol=1e-3).any(axis=1)
    blank = [is_blank(str(c).strip()) for c in cells.columns[names["tool_face"]]]
    return np.asarray(there & np.array(blank))


def _demand_numbers(
    cells: Cells, names: Mapping[str, str], bad: Mapping[str, Flags], where: str
) -> None:
    """Raise UnreadableInput that lists all cells that should be numbers."""
    places = [(int(k), role) for role, wrong in bad.items() for k in np.flatnonzero(wrong)]
    if not places:
        return
    places.sort(key=lambda place: place[0])
    said = [f"row {cells.row[k]}, column {names[role]}" for k, role in places]
    k, role = places[0]
    cell = str(cells.columns[names[role]][k])
    rows = list(dict.fromkeys(cells.row[k] for k, _ in places))
    shown = ",".join(map(str, rows[:_SHOWN]))
    what = f"'{cell}' is {'too large' if is_number(cell) else 'not a number'}"
    raise UnreadableInput(
        (what if cell else "the cell is empty") + and_more(said[1:]),
        where=f"{where}, {said[0]}",
        remedy=f"correct {'the cell' if len(said) == 1 else 'the cells'}, or leave "
        f"{'the row' if len(rows) == 1 else 'the rows'} out of the table (lab: --exclude {shown})",
    )


def _sessions(cells: Cells, name: str, path: Path) -> tuple[tuple[str, ...], Array]:
    """Names of sessions in order, and the number of each row's."""
    words = [f"{c:g}" if isinstance(c, float) else str(c).strip() for c in cells.columns[name]]
    if "" in words:
        raise UnreadableInput(
            "the session is empty",
            where=f"{path}, row {words.index('') + 1}, column {name}",
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
        if sensors := sensors_in(have):
            raise undecided(sensors, "", where)
        remedy += "; or give the log of rests in these positions: --recording LOG"
    elif {"inclination", "tool_face"} <= set(absent):
        remedy += "; or, without known angles, add --reference norm"
    if "inclination" in absent and any(h.strip().lower() in _FACE_NAMES for h in have):
        remedy = "add --reference direction where faces stand for angles"
    if "ux" in absent:
        remedy = "add a column face with +x, -x, +y, -y, +z or -z, or name it: --columns face=B"
    raise UnnamedColumns(
        f"no column for {', '.join(absent)} among: {', '.join(have)}", where=where, remedy=remedy
    )


def sensors_in(headings: list[str]) -> dict[str, tuple[str, str, str]]:
    """The headings of x, y and z of each sensor of a table, by what they share beside the word that
    names the axis: "A" of "Gx A [g]"."""
    found = {}
    for x, y, z in ([headings[k] for k in three] for three in triples_of(headings)):
        at = next(k for k, pair in enumerate(zip(x, y, strict=True)) if pair[0] != pair[1])
        word = next(m for m in re.finditer(r"[^\s_.:/-]+", x) if m.start() <= at < m.end())
        left = _UNIT.sub("", f"{x[: word.start()]} {x[word.end() :]}").strip(" _.:/-")
        name = " ".join(left.split()) or f"{x[:at]}{x[at + 1 :]}"
        found[name] = (x, y, z)
    return found


def _columns_of(mapping: FieldMapping | None, headings: list[str], where: str) -> dict[str, str]:
    """Role -> heading of the readings of the sensor that is named, if one is. Raises UsageError
    where it has none."""
    if mapping is None or not mapping.sensor:
        return {}
    found = sensors_in(headings)
    if mapping.sensor not in found:
        raise undecided(found, mapping.sensor, where)
    return dict(zip("xyz", found[mapping.sensor], strict=True))


def _numbers(cells: Array | list[str]) -> Array:
    """The cells as numbers, NaN where they are none."""
    if not isinstance(cells, list):
        return np.array(cells, dtype=np.float64)
    return np.array([float(c) if is_number(c) else np.nan for c in cells])


def _face_heading(headings: list[str], chosen: str, where: str) -> str:
    """The heading of the column of faces, or nothing. Raises as `roles_of` does."""
    if chosen and chosen not in headings:
        there = f"there are: {', '.join(headings)}"
        raise UsageError(f"no column is called '{chosen}'", where=where, remedy=there)
    if chosen:
        return chosen
    hits = [h for h in headings if h.strip().lower() in _FACE_NAMES]
    both = [h for h in headings if h.strip().lower() in ROLES["ux"]] if hits else []
    if len(hits) + len(both) > 1:
        raise UnreadableInput(
            f"several columns could be the direction: {', '.join((*hits, *both))}",
            where=where,
            remedy=f"choose one with {paste('--columns', f'face={hits[0]}')}, or rename the others",
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
    return dict(zip(_DIRECTION, found.T, strict=True))


def write_position_table(table: PositionTable, path: Path, *, angles_only: bool = False) -> None:
    """Write a table as CSV, whole or not at all; `angles_only` leaves the readings out."""
    roles = [r for r in table.columns if not (angles_only and r in ("x", "y", "z"))]
    lines = [",".join(table.names.get(role, role) for role in roles)]
    lines += [",".join(f"{table.columns[role][k]:.10g}" for role in roles) for k in range(table.n)]
    path.parent.mkdir(parents=True, exist_ok=True)
    with replace_atomically(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")
