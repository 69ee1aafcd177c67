"""Which columns to read: the user's, else by name, else by the device, else by their number.

Before that, what the lines above the table state; and where nothing is found, what there is.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput, UsageError
from imucalib.readers.columns import (
    Column,
    Content,
    is_date,
    listing,
    norm_of,
    parts_of_time,
    understand,
)
from imucalib.readers.csv.text import Dialect, cells_of, is_number
from imucalib.readers.devices.catalogue import UNKNOWN, Device, Start, device_named_in
from imucalib.readers.timebase import start_of
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Correction, corrections_of
from imucalib.units import ACCELERATION_UNITS, RATE_UNITS, canonical

_NUMBER = r"(\d+(?:[.,]\d+)?)"
#: A rate of samples says so, or has a unit; that of a filter, a line or a heart is none.
_RATE = re.compile(
    rf"(?:sampl\w*\s*(?:rate|freq\w*)|measurement frequency|update rate)[^0-9\n]{{0,12}}{_NUMBER}"
    rf"\s*(?:hz\b|$|[,;\s])"
    rf"|(?<!baud )(?<!heart )(?<!bit )(?:\brate[^0-9\n]{{0,12}}|(?<!pass )(?<!filter )\bat\s+)"
    rf"{_NUMBER}\s*hz\b",
    re.IGNORECASE | re.MULTILINE,
)
_UNIT = re.compile(
    r"^\W*(acc\w*|beschl\w*|gyr\w*|angular rates?|angular velocity)\s*(?:units?|in|einheit)?\s*"
    r"(?:\bin\b|[:=])\s*[\[(]?([^\s,;\])]+)[\])]?\s*$",
    re.IGNORECASE | re.MULTILINE,
)
_OWN_ROWS = re.compile(
    r"(# imucal recording, rows: (\d+)[^\n]*?)(?:, crc32: ([^\n]*))?$", re.MULTILINE
)
_OWN_MARK = re.compile(r"^# corrected: (.*)$", re.MULTILINE)
_OWN_START = re.compile(r"start_ns\s*[:=]\s*(-?\d+)")


@dataclass(frozen=True)
class Stated:
    """What our own first line says of the table: its rows and, where it has it, the CRC-32 of the
    lines below followed by `line`, its own start."""

    rows: int
    line: str = ""
    crc: int | None = None

    def contradicted(self, rows: int, crc: int) -> list[str]:
        """A sentence for what was found otherwise. crc : of the lines below"""
        if rows != self.rows:
            return [f"the header states {self.rows} rows, {rows} were found"]
        if self.crc is not None and zlib.crc32(self.line.encode(), crc) != self.crc:
            return ["the table is not what was written (CRC-32): numbers in it were changed"]
        return []


@dataclass(frozen=True)
class HeaderFacts:
    """device : whose export it is; rate in Hz; start_ns as in Recording.

    acc_unit, gyro_unit : that a line above the table states, in the usual spelling
    stated : what the file says of its rows, or None; corrections as in Recording
    """

    device: Device = UNKNOWN
    rate: float | None = None
    start_ns: int | None = None
    notes: tuple[str, ...] = ()
    stated: Stated | None = None
    corrections: tuple[Correction, ...] = ()
    acc_unit: str = ""
    gyro_unit: str = ""


def facts_of(preamble: Sequence[str], where: str) -> HeaderFacts:
    """Read the lines above the table. Raises UnreadableInput for what holds no raw data."""
    text = "\n".join(preamble)
    found = _RATE.search(text)
    rate = float((found[1] or found[2]).replace(",", ".")) if found else None
    units = {name[:3].lower(): canonical(unit) for name, unit in _UNIT.findall(text)}
    force, turn = units.get("acc") or units.get("bes", ""), units.get("gyr") or units.get("ang", "")
    own = _OWN_START.search(text)
    notes: list[str] = []
    start = start_of(int(own.group(1)), notes) if own else None
    own_line = _OWN_ROWS.search(text)
    stated = _rows_stated(*own_line.groups()) if own_line else None
    device = device_named_in(text)
    device.refuse(text, where)
    told = device.start(text) if device.start else Start(start)
    marks = corrections_of(_OWN_MARK.findall(text) if stated else ())
    notes += [*told.notes, *map(str, marks)]
    return HeaderFacts(
        device,
        rate or told.rate or None,
        told.start_ns,
        tuple(notes),
        stated,
        marks,
        acc_unit=force if force in ACCELERATION_UNITS else "",
        gyro_unit=turn if turn in RATE_UNITS else "",
    )


def _rows_stated(line: str, rows: str, crc: str | None) -> Stated:
    try:
        return Stated(int(rows), line, None if crc is None else int(crc, 16))
    except ValueError:  # a damaged sum fits nothing
        return Stated(int(rows), line, -1)


_ROWS = 50  # of each look


def contents_of(dialect: Dialect, pieces: Sequence[bytes]) -> tuple[Content, ...]:
    """Every column with its median, and every three neighbours whose norm is that of gravity."""
    rows = rows_of(dialect, pieces)
    names = [dialect.address(i) for i in range(dialect.width)]
    columns: list[Content] = []
    for i, name in enumerate(names):
        if not dialect.numeric[i]:
            example = next((row[i] for row in rows), "")
            columns.append(Content(name, f"text such as '{example[:30]}'", 0))
            continue
        values = _numbers([row[i] for row in rows], dialect.decimal)
        finite = values[np.isfinite(values)]
        median = float(np.median(finite)) if finite.size else float("nan")
        columns.append(Content(name, "numbers", 0, median=median))
    return (*columns, *_triples(dialect, names, rows))


def _triples(dialect: Dialect, names: list[str], rows: list[list[str]]) -> list[Content]:
    """Three neighbours that hardly change their norm while each of them changes: gravity's mark."""
    found = []
    for i in range(dialect.width - 2):
        if not all(dialect.numeric[i : i + 3]):
            continue
        axes = [_numbers([row[k] for row in rows], dialect.decimal) for k in range(i, i + 3)]
        values = np.stack(axes, axis=1)
        values = values[np.isfinite(values).all(axis=1)]
        norms = np.linalg.norm(values, axis=1)
        low, middle, high = np.percentile(norms, [25, 50, 75]) if norms.size else (0.0, 0.0, 0.0)
        turns = values.size and (np.ptp(values, axis=0) > 0.2 * middle).all()
        if middle > 0 and turns and high - low < 0.05 * middle:
            address = ",".join(names[i : i + 3])
            found.append(Content(address, "one vector?", 0, norm=norm_of(values)))
    return found


def like_gravity(dialect: Dialect, pieces: Sequence[bytes], columns: Sequence[int]) -> bool:
    """Whether the median norm of three columns is that of gravity in m/s², g or mg."""
    rows = rows_of(dialect, pieces)
    axes = [_numbers([row[k] for row in rows], dialect.decimal) for k in columns]
    return Content("", "", 0, norm=norm_of(np.stack(axes, axis=1))).like_gravity


def rows_of(dialect: Dialect, pieces: Sequence[bytes]) -> list[list[str]]:
    """The cells of some rows of every look."""
    rows = []
    for number, piece in enumerate(pieces):
        lines = piece.decode("utf-8", errors="replace").split("\n")[:-1]
        lines = lines[dialect.data_line - 1 :] if number == 0 else lines
        step = max(1, len(lines) // _ROWS)
        for line in lines[::step]:
            row = cells_of(line, dialect.delimiter)
            if len(row) >= dialect.width:
                rows.append(row)
    return rows


def _numbers(cells: list[str], decimal: str) -> Array:
    return np.array(
        [float(c.replace(decimal, ".")) if is_number(c, decimal) else np.nan for c in cells]
    )


def nothing_found(dialect: Dialect, pieces: Sequence[bytes], where: str) -> UnreadableInput:
    """The error for a table in which no names tell of an acceleration or an angular rate."""
    held = contents_of(dialect, pieces)
    what = (
        "no acceleration columns among"
        if dialect.names
        else (f"the {dialect.width} columns have no names")
    )
    vectors = [c for c in held if "," in c.address]
    option = vectors[0].address if len(vectors) == 1 else "X,Y,Z"
    return UnreadableInput(
        f"{what}:{listing(held)}\n",
        where=where,
        remedy=f"Name them: --acc {option} (and --gyro, --time or --rate, --unit)",
    )


_GYROSCOPE = re.compile(r"gyro|angular|drehrate", re.IGNORECASE)


@dataclass(frozen=True)
class Vector:
    """One quantity of one triad: three columns, or one for a temperature, and the stated unit,
    or one an axis: "m/s2,m/s2,g"."""

    quantity: str
    triad: str
    columns: tuple[int, ...]
    unit: str = ""


@dataclass(frozen=True)
class Selection:
    """Vectors to read; time : column, those that make a stamp together, or none; time_unit as the
    name states it; time_order : of the parts of a stamp, where these are known; notes."""

    vectors: tuple[Vector, ...]
    time: tuple[int, ...]
    time_unit: str
    notes: tuple[str, ...] = ()
    time_order: str = ""


@dataclass(frozen=True)
class _Table:
    mapping: FieldMapping
    columns: list[Column]
    dialect: Dialect


def select(
    dialect: Dialect,
    mapping: FieldMapping,
    facts: HeaderFacts,
    pieces: Sequence[bytes],
    stem: str = "",
) -> Selection:
    """Choose the columns: none when neither an acceleration nor an angular rate is found.

    pieces : the looks; stem : the file's name, which tells a phone's sensors apart
    Raises UsageError for a column that is not there.
    """
    notes: list[str] = []
    gyroscope = bool(_GYROSCOPE.search(stem)) and "acc" not in stem.lower()
    columns = understand(dialect.names, "angular_rate" if gyroscope else "acceleration")
    if gyroscope and any(c.quantity for c in columns) and columns != understand(dialect.names):
        notes.append("x, y, z are taken as an angular rate, by the name of the file")
    table = _Table(mapping, columns, dialect)
    vectors = [
        *_vectors("acceleration", mapping.acc, table, notes),
        *_vectors("angular_rate", mapping.gyro, table, notes),
    ]
    time, time_unit, order = _time(mapping, columns, dialect)
    free = not time and not mapping.rate and not columns
    if vectors and free:
        time = _time_beside(vectors, dialect, facts.device, notes)
    if not vectors:
        vectors, guessed = _by_position(dialect, facts, pieces, notes)
        time = guessed if free else time
    if not vectors:
        return Selection((), (), "")
    if len(time) > 1:
        names = ", ".join(dialect.names[k] if dialect.names else str(k + 1) for k in time)
        notes.append(f"time: columns {names} taken together")
    vectors = _beside(
        [_with_device_unit(_with_unit_above(v, facts), facts.device) for v in vectors]
    )
    temperatures = _temperatures(mapping, columns, facts, dialect)
    return Selection((*vectors, *temperatures), time, time_unit, tuple(notes), order)


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


def _with_unit_above(vector: Vector, facts: HeaderFacts) -> Vector:
    """The vector with the unit that the lines above the table state; with both, where its heading
    states another: no unit that is known, which is refused."""
    unit = facts.acc_unit if vector.quantity == "acceleration" else facts.gyro_unit
    if not unit or {canonical(part) for part in vector.unit.split(",")} == {unit}:
        return vector
    stated = f"{unit} (above the table; {vector.unit} in the heading)" if vector.unit else unit
    return replace(vector, unit=stated)


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
    units = [c.unit for c in columns]
    return units[0] if len(set(units)) == 1 else ",".join(units)


def _stated(quantity: str, stated: Sequence[str], table: _Table) -> list[Vector]:
    mapping, columns, dialect = table.mapping, table.columns, table.dialect
    option = "acc" if quantity == "acceleration" else "gyro"
    if len(stated) % 3:
        raise UsageError(
            f"{len(stated)} columns do not make triads",
            where=f"mapping: {option}",
            remedy="name three columns for each sensor",
        )
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


def _time(
    mapping: FieldMapping, columns: list[Column], dialect: Dialect
) -> tuple[tuple[int, ...], str, str]:
    """Columns of the stamps, the unit that the heading states, and the order of known parts."""
    if mapping.time:
        indices = _addressed(mapping.time, dialect)
        order = parts_of_time([dialect.names[k] for k in indices]) if columns else {}
        known = "".join(order) if list(order.values()) == list(range(len(indices))) else ""
        return indices, columns[indices[0]].unit if columns else "", known
    if mapping.rate:
        return (), "", ""
    parts = parts_of_time(dialect.names)
    found = [c for c in columns if c.quantity == "time" and c.index not in parts.values()]
    dates = [k for k, name in enumerate(dialect.names) if is_date(name)]
    if parts and not found:
        return tuple(parts.values()), "", "".join(parts)
    best = min(found, key=lambda c: "stamp" not in c.name.lower(), default=None)
    if best is None:
        alone = [k for k in dates if len(re.findall(r"\d+", dialect.example[k])) >= 5]
        return tuple(alone[:1]), "", ""
    clock = dialect.example[best.index] if dialect.example else ""
    bare = not dialect.numeric[best.index] and ":" in clock
    if dates and bare and len(re.findall(r"\d+", clock)) <= 4:
        return (dates[0], best.index), "", ""
    return (best.index,), best.unit, ""


def _addressed(text: str, dialect: Dialect) -> tuple[int, ...]:
    """The columns of a stamp: one name, which may hold a comma, or several."""
    try:
        return (column_index(text, dialect, "time"),)
    except UsageError:
        if "," not in text:
            raise
    return tuple(column_index(part, dialect, "time") for part in text.split(","))


def _time_beside(
    vectors: Sequence[Vector], dialect: Dialect, device: Device, notes: list[str]
) -> tuple[int, ...]:
    """The time column of a table without names whose other columns the user has named."""
    taken = {c for v in vectors for c in v.columns}
    known = _numbered((device.fields.time,), dialect)[:1]
    if known and known[0] not in taken:
        return known
    if 0 not in taken and (dialect.width == 1 + len(taken) or not dialect.numeric[0]):
        notes.append("no column names: column 1 taken as time")
        return (0,)
    return ()


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
    dialect: Dialect, facts: HeaderFacts, pieces: Sequence[bytes], notes: list[str]
) -> tuple[list[Vector], tuple[int, ...]]:
    """Columns of a table without (useful) names: a known device, or [date,] [time,] x, y, z and
    perhaps the three of the other sensor, which is told by gravity's norm."""
    if dialect.names and any(c.quantity for c in understand(dialect.names)):
        return [], ()
    fields = facts.device.fields
    if known := _numbered(fields.acc, dialect):
        time = _numbered((fields.time,), dialect)[:1]
        if not time and not dialect.numeric[known[0]]:  # some exports put a stamp in front
            known, time = tuple(k + 1 for k in known), (known[0],)
        if known[-1] < dialect.width:
            return [Vector("acceleration", "imu0", known)], time
    words = next((k for k, n in enumerate(dialect.numeric) if n), dialect.width)
    if words > 2 or not all(dialect.numeric[words:]):
        return [], ()
    front = words or int(dialect.width in (4, 7))
    numbers = tuple(range(front, dialect.width))
    time, said = tuple(range(front)), "time, " * bool(front)
    if len(numbers) == 3:
        notes.append(f"no column names: taken as {said}x, y, z")
        return [Vector("acceleration", "imu0", numbers)], time
    if len(numbers) == 6:
        heavy = [at for at in (numbers[:3], numbers[3:]) if like_gravity(dialect, pieces, at)]
        if len(heavy) == 1:
            other = numbers[3:] if heavy[0] == numbers[:3] else numbers[:3]
            first = "accelerometer, gyroscope" if heavy[0] < other else "gyroscope, accelerometer"
            notes.append(f"no column names: taken as {said}{first}, by the norm of gravity")
            return [
                Vector("acceleration", "imu0", heavy[0]),
                Vector("angular_rate", "imu0", other),
            ], time
    return [], ()
