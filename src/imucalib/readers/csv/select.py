"""Which columns to read: the user's, else by name, else by the device, else by their number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from imucalib.errors import UsageError
from imucalib.readers.columns import Column, understand
from imucalib.readers.csv.dialect import Dialect
from imucalib.readers.csv.header import HeaderFacts
from imucalib.readers.devices.catalogue import Device
from imucalib.recording.mapping import FieldMapping


@dataclass(frozen=True)
class Vector:
    """One quantity of one triad: three columns, or one for a temperature, and the stated unit."""

    quantity: str
    triad: str
    columns: tuple[int, ...]
    unit: str = ""


@dataclass(frozen=True)
class Selection:
    """Vectors to read; time : column or -1; time_unit as the name states it; notes."""

    vectors: tuple[Vector, ...]
    time: int
    time_unit: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Table:
    mapping: FieldMapping
    columns: list[Column]
    dialect: Dialect


def select(dialect: Dialect, mapping: FieldMapping, facts: HeaderFacts, where: str) -> Selection:
    """Choose the columns: none when neither an acceleration nor an angular rate is found.

    Raises UsageError for a column that is not there.
    """
    columns = understand(dialect.names) if dialect.names else []
    notes: list[str] = []
    table = _Table(mapping, columns, dialect)
    vectors = [
        *_vectors("acceleration", mapping.acc, table, notes),
        *_vectors("angular_rate", mapping.gyro, table, notes),
    ]
    time, time_unit = _time(mapping, columns, dialect)
    if vectors and time < 0 and not mapping.rate and not columns:
        time = _time_beside(vectors, dialect, facts.device, notes)
    if not vectors:
        vectors, guessed = _by_position(dialect, facts, notes)
        time = guessed if time < 0 and not mapping.rate and not columns else time
    if not vectors:
        return Selection((), -1, "")
    vectors = _beside([_with_device_unit(v, facts.device) for v in vectors])
    temperatures = _temperatures(mapping, columns, facts, dialect)
    return Selection((*vectors, *temperatures), time, time_unit, tuple(notes))


def _vectors(quantity: str, stated: Sequence[str], table: _Table, notes: list[str]) -> list[Vector]:
    if stated:
        return _stated(quantity, stated, table)
    groups: dict[str, dict[int, Column]] = {}
    for column in table.columns:
        if column.quantity != quantity or not table.dialect.numeric[column.index]:
            continue
        axes = groups.setdefault(column.triad, {})
        if column.axis in axes:
            notes.append(f"column '{column.name}' left out: '{axes[column.axis].name}' is used")
        else:
            axes[column.axis] = column
    vectors = []
    for triad, axes in groups.items():
        if len(axes) < 3:
            names = ", ".join(c.name for c in axes.values())
            notes.append(f"columns {names} left out: a triad needs x, y and z")
            continue
        indices = tuple(axes[k].index for k in range(3))
        vectors.append(Vector(quantity, triad, indices, _common_unit(list(axes.values()))))
    return vectors


def _beside(vectors: list[Vector]) -> list[Vector]:
    """A gyroscope whose name begins that of one accelerometer only ("s1", "s1_ln") is with it."""
    acc = [v.triad for v in vectors if v.quantity == "acceleration"]
    out = []
    for v in vectors:
        fitting = [a for a in acc if a.startswith(f"{v.triad}_")]
        lonely = v.quantity == "angular_rate" and v.triad not in acc and len(fitting) == 1
        out.append(replace(v, triad=fitting[0]) if lonely else v)
    return out


def _with_device_unit(vector: Vector, device: Device) -> Vector:
    """The vector, with the unit that its device always writes when the file names none."""
    if vector.unit:
        return vector
    fields = device.fields
    unit = fields.acc_unit if vector.quantity == "acceleration" else fields.gyro_unit
    return replace(vector, unit=unit)


def _numbered(addresses: Sequence[str], dialect: Dialect) -> tuple[int, ...]:
    """Indices from 0 of a device's columns; none unless all are numbers that the table has."""
    indices = tuple(int(a) - 1 for a in addresses if a.isdecimal() and int(a) <= dialect.width)
    return indices if len(indices) == len(addresses) else ()


def _common_unit(columns: Sequence[Column]) -> str:
    units = {c.unit for c in columns}
    return units.pop() if len(units) == 1 else ""


def _stated(quantity: str, stated: Sequence[str], table: _Table) -> list[Vector]:
    mapping, columns, dialect = table.mapping, table.columns, table.dialect
    option = "acc" if quantity == "acceleration" else "gyro"
    if len(stated) % 3:
        raise UsageError(
            f"{len(stated)} columns do not make triads", where=f"mapping: {option}",
            remedy="name three columns for each sensor",
        )  # fmt: skip
    vectors = []
    before = len(mapping.acc) // 3 if quantity == "angular_rate" else 0
    own = before if len(mapping.triads) >= before + len(stated) // 3 else 0
    for k in range(len(stated) // 3):
        triad = mapping.triads[own + k] if own + k < len(mapping.triads) else f"imu{k}"
        indices = tuple(column_index(s, dialect, option) for s in stated[3 * k : 3 * k + 3])
        unit = _common_unit([columns[i] for i in indices]) if columns else ""
        vectors.append(Vector(quantity, triad, indices, unit))
    return vectors


def column_index(address: str, dialect: Dialect, option: str) -> int:
    """Index from 0 of the column with this name (unit optional) or number from 1."""
    wanted = address.strip().lower()
    full = [n.lower() for n in dialect.names]
    bare = [c.name.lower() for c in understand(dialect.names)]
    for names in (full, bare):
        if wanted in names:
            return names.index(wanted)
    if wanted.isdecimal() and 1 <= int(wanted) <= dialect.width:
        return int(wanted) - 1
    have = ", ".join(dialect.names) or f"1 to {dialect.width} (the file has no names)"
    raise UsageError(
        f"no column '{address}'", where=f"mapping: {option}", remedy=f"columns: {have}"
    )


def _time(mapping: FieldMapping, columns: list[Column], dialect: Dialect) -> tuple[int, str]:
    if mapping.time:
        index = column_index(mapping.time, dialect, "time")
        return index, columns[index].unit if columns else ""
    if mapping.rate:
        return -1, ""
    found = [c for c in columns if c.quantity == "time"]
    if not found:
        return -1, ""
    best = min(found, key=lambda c: "stamp" not in c.name.lower())
    return best.index, best.unit


def _time_beside(
    vectors: Sequence[Vector], dialect: Dialect, device: Device, notes: list[str]
) -> int:
    """The time column of a table without names whose other columns the user has named, or -1."""
    taken = {c for v in vectors for c in v.columns}
    known = next(iter(_numbered((device.fields.time,), dialect)), -1)
    if known >= 0 and known not in taken:
        return known
    if 0 not in taken and (dialect.width == 1 + len(taken) or not dialect.numeric[0]):
        notes.append("no column names: column 1 taken as time")
        return 0
    return -1


def _temperatures(
    mapping: FieldMapping, columns: list[Column], facts: HeaderFacts, dialect: Dialect
) -> list[Vector]:
    if mapping.temperature:
        out = []
        for k, address in enumerate(mapping.temperature):
            triad = mapping.triads[k] if k < len(mapping.triads) else f"imu{k}"
            index = column_index(address, dialect, "temperature")
            out.append(
                Vector("temperature", triad, (index,), columns[index].unit if columns else "")
            )
        return out
    fields = facts.device.fields
    if not columns and (known := _numbered(fields.temperature, dialect)):
        return [Vector("temperature", "imu0", known, fields.temperature_unit)]
    first: dict[str, Vector] = {}
    for c in columns:
        if c.quantity == "temperature" and dialect.numeric[c.index]:
            first.setdefault(c.triad, Vector("temperature", c.triad, (c.index,), c.unit))
    return list(first.values())


def _by_position(
    dialect: Dialect, facts: HeaderFacts, notes: list[str]
) -> tuple[list[Vector], int]:
    """Columns of a table without (useful) names: a known device, or [time,] x, y, z."""
    if dialect.names and any(c.quantity for c in understand(dialect.names)):
        return [], -1
    fields = facts.device.fields
    if known := _numbered(fields.acc, dialect):
        time = next(iter(_numbered((fields.time,), dialect)), -1)
        if time < 0 and not dialect.numeric[known[0]]:  # some exports put a stamp in front
            known, time = tuple(k + 1 for k in known), known[0]
        if known[-1] < dialect.width:
            return [Vector("acceleration", "imu0", known)], time
    numbers = [i for i, n in enumerate(dialect.numeric) if n]
    if dialect.width == 4 and numbers[-3:] == [1, 2, 3]:
        notes.append("no column names: taken as time, x, y, z")
        return [Vector("acceleration", "imu0", (1, 2, 3))], 0
    if dialect.width == 3 and len(numbers) == 3:
        notes.append("no column names: taken as x, y, z")
        return [Vector("acceleration", "imu0", (0, 1, 2))], -1
    return [], -1
