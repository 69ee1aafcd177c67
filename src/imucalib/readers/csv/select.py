"""Which columns to read: the user's, else by name, else by the device, else by their number.

Before that, what the lines above the table state; and where nothing is found, what there is.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

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
from imucalib.readers.csv.dialect import Dialect
from imucalib.readers.csv.text import is_number
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
_UNITS = {"acceleration": ACCELERATION_UNITS, "angular_rate": RATE_UNITS}
_OWN_ROWS = re.compile(
    r"(# imucal recording, rows: (\d+)[^\n]*?)(?:, crc32: ([^\n]*))?$", re.MULTILINE
)
_OWN_MARK = re.compile(r"^# corrected: (.*)$", re.MULTILINE)
_OWN_START = re.compile(r"start_ns\s*[:=]\s*(-?\d+)")
_GYROSCOPE = re.compile(r"gyro|angular|drehrate", re.IGNORECASE)


@dataclass(frozen=True)
class HeaderFacts:
    """What the lines above the table state.

    device : whose export it is; rate in Hz; start_ns, corrections as in Recording
    units : quantity -> unit, in the usual spelling
    rows : that our own first line states, or None; crc : its CRC-32 of the lines below it followed
        by `line`, its own start
    """

    device: Device = UNKNOWN
    rate: float | None = None
    start_ns: int | None = None
    notes: tuple[str, ...] = ()
    corrections: tuple[Correction, ...] = ()
    units: dict[str, str] = field(default_factory=dict)
    rows: int | None = None
    line: str = ""
    crc: int | None = None

    def contradicted(self, rows: int, crc: int) -> list[str]:
        """A sentence for what was found otherwise. crc : of the lines below our own first"""
        if self.rows is not None and rows != self.rows:
            return [f"the header states {self.rows} rows, {rows} were found"]
        if self.crc is not None and zlib.crc32(self.line.encode(), crc) != self.crc:
            return ["the table is not what was written (CRC-32): numbers in it were changed"]
        return []


def facts_of(preamble: Sequence[str], where: str) -> HeaderFacts:
    """Read the lines above the table. Raises UnreadableInput for what holds no raw data."""
    text, notes = "\n".join(preamble), list[str]()
    found, own, start = _RATE.search(text), _OWN_ROWS.search(text), _OWN_START.search(text)
    device = device_named_in(text)
    device.refuse(text, where)
    begin = Start(start_of(int(start.group(1)), notes) if start else None)
    begin = device.start(text) if device.start else begin
    marks = corrections_of(_OWN_MARK.findall(text) if own else ())
    rate = float((found[1] or found[2]).replace(",", ".")) if found else None
    stated = {name[:3].lower(): canonical(unit) for name, unit in _UNIT.findall(text)}
    units = {
        "acceleration": stated.get("acc") or stated.get("bes", ""),
        "angular_rate": stated.get("gyr") or stated.get("ang", ""),
    }
    return HeaderFacts(
        device=device,
        rate=rate or begin.rate or None,
        start_ns=begin.start_ns,
        notes=(*notes, *begin.notes, *map(str, marks)),
        corrections=marks,
        units={quantity: unit for quantity, unit in units.items() if unit in _UNITS[quantity]},
        rows=int(own[2]) if own else None,
        line=own[1] if own else "",
        crc=_sum_of(own[3]) if own and own[3] is not None else None,
    )


def _sum_of(text: str) -> int:
    try:
        return int(text, 16)
    except ValueError:  # a damaged sum fits nothing
        return -1


def nothing_found(dialect: Dialect, pieces: Sequence[bytes], where: str) -> UnreadableInput:
    """The error for a table in which no names tell of an acceleration or an angular rate: every
    column with its median, and every three neighbours whose norm is that of gravity."""
    rows = dialect.rows_of(pieces)
    names = [dialect.address(i) for i in range(dialect.width)]
    columns, vectors = list[Content](), list[Content]()
    for i, name in enumerate(names):
        if not dialect.numeric[i]:
            example = next((row[i] for row in rows), "")
            columns.append(Content(name, f"text such as '{example[:30]}'", 0))
            continue
        values = _numbers(rows, (i,), dialect.decimal)
        finite = values[np.isfinite(values)]
        median = float(np.median(finite)) if finite.size else float("nan")
        columns.append(Content(name, "numbers", 0, median=median))
    for i in range(dialect.width - 2):
        if all(dialect.numeric[i : i + 3]):
            values = _numbers(rows, range(i, i + 3), dialect.decimal)
            if _is_gravity(values[np.isfinite(values).all(axis=1)]):
                address = ",".join(names[i : i + 3])
                vectors.append(Content(address, "one vector?", 0, norm=norm_of(values)))
    what = f"the {dialect.width} columns have no names"
    option = vectors[0].address if len(vectors) == 1 else "X,Y,Z"
    return UnreadableInput(
        ("no acceleration columns among" if dialect.names else what)
        + f":{listing([*columns, *vectors])}\n",
        where=where,
        remedy=f"Name them: --acc {option} (and --gyro, --time or --rate, --unit)",
    )


def _is_gravity(values: Array) -> bool:
    """Whether vectors (n, 3) hardly change their norm while each axis changes: gravity's mark."""
    if not values.size:
        return False
    low, middle, high = np.percentile(np.linalg.norm(values, axis=1), [25, 50, 75])
    turns = (np.ptp(values, axis=0) > 0.2 * middle).all()
    return bool(middle > 0 and turns and high - low < 0.05 * middle)


def _numbers(rows: Sequence[Sequence[str]], columns: Sequence[int], decimal: str) -> Array:
    """(n, k) numbers of some columns, NaN for what is none."""

    def number(cell: str) -> float:
        return float(cell.replace(decimal, ".")) if is_number(cell, decimal) else np.nan

    found = [[number(row[k]) for k in columns] for row in rows]
    return np.array(found).reshape(len(rows), len(columns))


@dataclass(frozen=True)
class Vector:
    """One quantity of one triad: three columns, or one for a temperature, and the stated unit,
    or one an axis: "m/s2,m/s2,g"."""

    quantity: str
    triad: str
    columns: tuple[int, ...]
    unit: str = ""

    @property
    def name(self) -> str:
        """Of its channel."""
        return f"{self.triad}/{self.quantity}"


@dataclass(frozen=True)
class Selection:
    """Vectors to read; time : column, those that make a stamp together, or none; time_unit as the
    name states it; time_order : of the parts of a stamp, where these are known; notes."""

    vectors: tuple[Vector, ...]
    time: tuple[int, ...]
    time_unit: str
    notes: tuple[str, ...] = ()
    time_order: str = ""


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
    vectors: list[Vector] = []
    for quantity, stated in (("acceleration", mapping.acc), ("angular_rate", mapping.gyro)):
        if stated:
            vectors += _stated(quantity, stated, mapping, columns, dialect)
        else:
            vectors += _by_name(quantity, columns, dialect, notes)
    time, time_unit, order = _time(mapping, columns, dialect)
    free = not time and not mapping.rate and not columns
    if vectors and free:
        time = _first_column(vectors, dialect, facts.device, notes)
    if not vectors:
        vectors, guessed = _by_position(dialect, facts.device, pieces, notes)
        time = guessed if free else time
    if not vectors:
        return Selection((), (), "")
    if len(time) > 1:
        names = ", ".join(dialect.names[k] if dialect.names else str(k + 1) for k in time)
        notes.append(f"time: columns {names} taken together")
    vectors = _paired([_with_unit(v, facts) for v in vectors])
    vectors += _temperatures(mapping, columns, facts.device, dialect)
    return Selection(tuple(vectors), time, time_unit, tuple(notes), order)


def _by_name(
    quantity: str, columns: Sequence[Column], dialect: Dialect, notes: list[str]
) -> list[Vector]:
    groups: dict[str, dict[int, Column]] = {}
    for column in columns:
        if column.quantity == quantity and dialect.numeric[column.index]:
            axes = groups.setdefault(column.triad, {})
            used = axes.setdefault(column.axis, column)
            if used is not column:
                notes.append(f"column '{column.name}' left out: '{used.name}' is used")
    vectors = []
    for triad, axes in groups.items():
        if len(axes) < 3:
            names = ", ".join(c.name for c in axes.values())
            notes.append(f"columns {names} left out: a triad needs x, y and z")
            continue
        indices = tuple(axes[k].index for k in range(3))
        vectors.append(Vector(quantity, triad, indices, _common_unit(list(axes.values()))))
    return vectors


def _paired(vectors: list[Vector]) -> list[Vector]:
    """A gyroscope whose name begins that of one accelerometer only ("s1", "s1_ln") is with it."""
    acc = [v.triad for v in vectors if v.quantity == "acceleration"]
    out = []
    for v in vectors:
        fitting = [a for a in acc if a.startswith(f"{v.triad}_")]
        lonely = v.quantity == "angular_rate" and v.triad not in acc and len(fitting) == 1
        out.append(replace(v, triad=fitting[0]) if lonely else v)
    return out


def _with_unit(vector: Vector, facts: HeaderFacts) -> Vector:
    """The vector with the unit that the lines above the table state; with both, where its heading
    states another: no unit that is known, which is refused. Where neither does, its device's."""
    above = facts.units.get(vector.quantity)
    if above and {canonical(part) for part in vector.unit.split(",")} != {above}:
        both = f"{above} (above the table; {vector.unit} in the heading)"
        return replace(vector, unit=both if vector.unit else above)
    fields = facts.device.fields
    usual = fields.acc_unit if vector.quantity == "acceleration" else fields.gyro_unit
    return replace(vector, unit=vector.unit or usual)


def _numbered(addresses: Sequence[str], dialect: Dialect) -> tuple[int, ...]:
    """Indices from 0 of a device's columns; none unless all are numbers that the table has."""
    indices = tuple(int(a) - 1 for a in addresses if a.isdecimal() and int(a) <= dialect.width)
    return indices if len(indices) == len(addresses) else ()


def _common_unit(columns: Sequence[Column]) -> str:
    units = [c.unit for c in columns]
    return units[0] if len(set(units)) == 1 else ",".join(units)


def _stated(
    quantity: str,
    stated: Sequence[str],
    mapping: FieldMapping,
    columns: Sequence[Column],
    dialect: Dialect,
) -> list[Vector]:
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
        indices = tuple(column_index(s, dialect, option) for s in stated[3 * k : 3 * k + 3])
        unit = _common_unit([columns[i] for i in indices]) if columns else ""
        vectors.append(Vector(quantity, _triad(mapping, own + k, k), indices, unit))
    return vectors


def _triad(mapping: FieldMapping, at: int, number: int) -> str:
    return mapping.triads[at] if at < len(mapping.triads) else f"imu{number}"


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
    clock = dialect.example[best.index]
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


def _first_column(
    vectors: Sequence[Vector], dialect: Dialect, device: Device, notes: list[str]
) -> tuple[int, ...]:
    """The time column of a table without names whose other columns the user has named."""
    used = {c for v in vectors for c in v.columns}
    known = _numbered((device.fields.time,), dialect)[:1]
    if known and known[0] not in used:
        return known
    if 0 not in used and (dialect.width == 1 + len(used) or not dialect.numeric[0]):
        notes.append("no column names: column 1 taken as time")
        return (0,)
    return ()


def _temperatures(
    mapping: FieldMapping, columns: list[Column], device: Device, dialect: Dialect
) -> list[Vector]:
    if mapping.temperature:
        out = []
        for k, address in enumerate(mapping.temperature):
            index = column_index(address, dialect, "temperature")
            unit = columns[index].unit if columns else ""
            out.append(Vector("temperature", _triad(mapping, k, k), (index,), unit))
        return out
    fields = device.fields
    if not columns and (known := _numbered(fields.temperature, dialect)):
        return [Vector("temperature", "imu0", known, fields.temperature_unit)]
    first: dict[str, Vector] = {}
    for c in columns:
        if c.quantity == "temperature" and dialect.numeric[c.index]:
            first.setdefault(c.triad, Vector("temperature", c.triad, (c.index,), c.unit))
    return list(first.values())


def _by_position(
    dialect: Dialect, device: Device, pieces: Sequence[bytes], notes: list[str]
) -> tuple[list[Vector], tuple[int, ...]]:
    """Columns of a table without (useful) names: a known device, or [date,] [time,] x, y, z and
    perhaps the three of the other sensor, which the norm of gravity tells apart."""
    if dialect.names and any(c.quantity for c in understand(dialect.names)):
        return [], ()
    if known := _numbered(device.fields.acc, dialect):
        time = _numbered((device.fields.time,), dialect)[:1]
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
    if len(numbers) == 6 and (found := _two_sensors(dialect, pieces, numbers, said, notes)):
        return found, time
    return [], ()


def _two_sensors(
    dialect: Dialect,
    pieces: Sequence[bytes],
    numbers: tuple[int, ...],
    said: str,
    notes: list[str],
) -> list[Vector]:
    """Two triples of columns, of which one has the norm of gravity; else none."""
    rows, halves = dialect.rows_of(pieces), (numbers[:3], numbers[3:])
    norms = [norm_of(_numbers(rows, at, dialect.decimal)) for at in halves]
    heavy = [Content("", "", 0, norm=norm).like_gravity for norm in norms]
    if sum(heavy) != 1:
        return []
    first = "accelerometer, gyroscope" if heavy[0] else "gyroscope, accelerometer"
    notes.append(f"no column names: taken as {said}{first}, by the norm of gravity")
    force, turn = halves if heavy[0] else halves[::-1]
    return [Vector("acceleration", "imu0", force), Vector("angular_rate", "imu0", turn)]
