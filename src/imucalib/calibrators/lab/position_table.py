"""Position tables: one row a position, with the angles that were set and, mostly, raw x, y, z.

Columns are found by name or given; every cell that is used must be a number. Rows are counted from
1 without the heading, as a person counts them.
"""

from __future__ import annotations

import csv
import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucalib.atomic_file import replaced_atomically
from imucalib.errors import UnreadableInput, UsageError

Array = NDArray[np.float64]

#: What a column can be, and the names under which it is found (without unit suffix, lower case).
ROLES: dict[str, tuple[str, ...]] = {
    "inclination": ("inclination", "incl", "inc"),
    "tool_face": ("toolface", "tool_face", "tf", "gtf", "toolface_angle", "tool face"),
    "x": ("x", "raw_x", "ax", "a_x", "acc_x", "accel_x", "rawx"),
    "y": ("y", "raw_y", "ay", "a_y", "acc_y", "accel_y", "rawy"),
    "z": ("z", "raw_z", "az", "a_z", "acc_z", "accel_z", "rawz"),
    "temperature": ("temperature", "temp", "t_sensor"),
    "time": ("time", "t"),
    "inclination_approach": ("inclination_approach", "incl_approach"),
    "tool_face_approach": ("tool_face_approach", "toolface_approach", "tf_approach"),
    "inclination_setting": ("inclination_setting",),
    "tool_face_setting": ("tool_face_setting", "toolface_setting"),
    "samples": ("samples", "n"),
}
_UNIT_SUFFIX = re.compile(
    r"(?:[_\s]*[\[(]|[_\s]+|(?=°))(deg|rad|degc|c|°|°c|g|mg|ug|m/s2|m/s\^2|lsb|counts|s)[\])]?$"
)


@dataclass(frozen=True)
class PositionTable:
    """Columns by role, each (n,), as numbers in the table's own units.

    unit : role -> unit that the heading states, when it does
    names : role -> heading; row : (n,) row numbers from 1; sha256 : of the file
    """

    columns: Mapping[str, Array]
    names: Mapping[str, str]
    unit: Mapping[str, str]
    row: NDArray[np.intp]
    path: str
    sha256: str

    def __contains__(self, role: object) -> bool:
        return role in self.columns

    @property
    def n(self) -> int:
        return len(self.row)

    def raw(self) -> Array:
        """(n, 3) raw readings."""
        return np.stack([self.columns[a] for a in "xyz"], axis=-1)


def read_position_table(
    path: Path,
    chosen: Mapping[str, str] | None = None,
    *,
    need_raw: bool = True,
    need_angles: bool = True,
) -> PositionTable:
    """Read a CSV or HDF5 table.

    chosen : role -> heading, overriding what is found by name
    Raises UnreadableInput (missing or non-numeric cells, with row and column; no file) and
    UsageError (an unknown role or heading in `chosen`).
    """
    if not path.is_file():
        raise UnreadableInput("no such file", where=str(path), remedy="check the path")
    data = path.read_bytes()
    if not data:
        raise UnreadableInput("the file is empty", where=str(path))
    hdf5 = data[:8] == b"\x89HDF\r\n\x1a\n"
    cells = _hdf5_cells(path) if hdf5 else _csv_cells(data, str(path))
    names = _roles(list(cells), chosen or {}, str(path))
    required = ("inclination", "tool_face") * need_angles + ("x", "y", "z") * need_raw
    absent = [role for role in required if role not in names]
    if absent:
        raise UnreadableInput(
            f"no column for {', '.join(absent)} among: {', '.join(cells)}",
            where=str(path),
            remedy="name it, for example --columns inclination=B,tool_face=C",
        )
    columns = {role: _numbers(cells[name], name, str(path)) for role, name in names.items()}
    unit = {role: _stated_unit(name) for role, name in names.items() if _stated_unit(name)}
    count = len(next(iter(columns.values())))
    digest = hashlib.sha256(data).hexdigest()
    return PositionTable(columns, names, unit, np.arange(1, count + 1), str(path), digest)


def _csv_cells(data: bytes, where: str) -> dict[str, list[str]]:
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UnreadableInput(
            "not a text file",
            where=f"{where}, byte {error.start}",
            remedy="give a CSV or HDF5 table",
        ) from None
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if not lines:
        raise UnreadableInput("no rows in it", where=where)
    delimiter = max(",;\t", key=lines[0].count)
    rows = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=delimiter)]
    heading, body = rows[0], rows[1:]
    if all(_is_number(cell, delimiter) for cell in heading if cell):
        raise UnreadableInput(
            "the first row is numbers, not headings", where=f"{where}, line 1",
            remedy="add a heading line such as: inclination,tool_face,x,y,z",
        )  # fmt: skip
    if len(set(heading)) != len(heading):
        raise UnreadableInput("two columns have the same heading", where=f"{where}, line 1")
    for number, row in enumerate(body, start=1):
        if len(row) != len(heading):
            raise UnreadableInput(
                f"{len(row)} cells where the heading has {len(heading)}",
                where=f"{where}, row {number}",
            )
    if not body:
        raise UnreadableInput("a heading but no rows", where=where)
    decimal = delimiter != ","
    return {
        name: [row[k].replace(",", ".") if decimal else row[k] for row in body]
        for k, name in enumerate(heading)
    }


def _is_number(cell: str, delimiter: str) -> bool:
    try:
        float(cell.replace(",", ".") if delimiter != "," else cell)
    except ValueError:
        return False
    return True


def _hdf5_cells(path: Path) -> dict[str, list[str]]:
    import h5py

    found: dict[str, list[str]] = {}

    def visit(name: str, item: object) -> None:
        if not isinstance(item, h5py.Dataset):
            return
        if item.dtype.names:
            for field in item.dtype.names:
                found[field] = [repr(float(v)) for v in item[field]]
        elif item.ndim == 1 and item.dtype.kind in "iuf":
            found[name.rsplit("/", maxsplit=1)[-1]] = [repr(float(v)) for v in item[...]]
        elif item.ndim == 2 and item.shape[1] == 3 and item.dtype.kind in "iuf":
            for axis, letter in enumerate("xyz"):
                found[letter] = [repr(float(v)) for v in item[:, axis]]

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except OSError as error:
        raise UnreadableInput(f"HDF5 says: {error}", where=str(path)) from None
    if len({len(v) for v in found.values()}) > 1:
        sizes = ", ".join(f"{name} {len(v)}" for name, v in found.items())
        raise UnreadableInput(f"datasets of different length ({sizes})", where=str(path))
    return found


def _plain(name: str) -> str:
    text = name.strip().lower()
    return _UNIT_SUFFIX.sub("", text) if len(text) > 2 else text


def _stated_unit(name: str) -> str:
    match = _UNIT_SUFFIX.search(name.strip().lower()) if len(name.strip()) > 2 else None
    return match.group(1) if match else ""


def _roles(headings: list[str], chosen: Mapping[str, str], where: str) -> dict[str, str]:
    names: dict[str, str] = {}
    for role, heading in chosen.items():
        if role not in ROLES:
            raise UsageError(f"unknown column role '{role}'", remedy=f"use: {', '.join(ROLES)}")
        if heading not in headings:
            raise UsageError(
                f"no column is called '{heading}'",
                where=where,
                remedy=f"there are: {', '.join(headings)}",
            )
        names[role] = heading
    for role, known in ROLES.items():
        if role in names:
            continue
        hits = [h for h in headings if (h.strip().lower() in known or _plain(h) in known)]
        hits = [h for h in hits if h not in names.values()]
        if len(hits) > 1:
            raise UnreadableInput(
                f"several columns could be {role}: {', '.join(hits)}",
                where=where,
                remedy=f"choose one with --columns {role}={hits[0]}",
            )
        if hits:
            names[role] = hits[0]
    return names


def _numbers(cells: list[str], name: str, where: str) -> Array:
    values = np.empty(len(cells))
    for k, cell in enumerate(cells):
        try:
            values[k] = float(cell)
        except ValueError:
            values[k] = np.nan
        if not np.isfinite(values[k]):
            shown = f"'{cell}' is not a number" if cell else "the cell is empty"
            raise UnreadableInput(
                shown, where=f"{where}, row {k + 1}, column {name}",
                remedy="correct the cell, or leave the row out of the table",
            )  # fmt: skip
    return values


def write_position_table(table: PositionTable, path: Path, *, angles_only: bool = False) -> None:
    """Write a table as CSV, whole or not at all; `angles_only` leaves the readings out."""
    roles = [r for r in table.columns if not (angles_only and r in ("x", "y", "z"))]
    heading = ",".join(table.names.get(role, role) for role in roles)
    lines = [heading]
    for k in range(table.n):
        lines.append(",".join(f"{table.columns[role][k]:.10g}" for role in roles))
    path.parent.mkdir(parents=True, exist_ok=True)
    with replaced_atomically(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")
