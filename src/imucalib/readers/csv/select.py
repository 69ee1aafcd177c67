"""Which columns to read: the user's, else by name, else by the device, else by their number.

Before that, what the lines above the table state; and where nothing is found, what there is.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Container, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import UnnamedColumns, UsageError
from imucalib.question import paste
from imucalib.readers.csv.dialect import Dialect
from imucalib.readers.csv.text import Condition, is_number
from imucalib.readers.devices.catalogue import UNKNOWN, Device, DeviceStart, device_named_in
from imucalib.readers.fields.choice import OPTIONS, Field, Vector, choose
from imucalib.readers.fields.contents import Content, listing, norm_of
from imucalib.readers.fields.timebase import start_of
from imucalib.readers.fields.words import (
    Meaning,
    bare_quantity,
    is_date,
    parts_of_time,
    triples_of,
    understand,
)
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import AppliedCalibration, corrections_of
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
_SERIAL = re.compile(r"serial (?:number|no\.?|code)[\s:;,]+([\w-]+)", re.IGNORECASE)
_ROWS = 50  # of each look
_OWN_START = re.compile(r"start_ns\s*[:=]\s*(-?\d+)")


@dataclass(frozen=True)
class HeaderFacts:
    """What the lines above the table state.

    device : whose export it is; rate in Hz; start_ns, corrections, serial as in Recording
    units : quantity -> unit, in the usual spelling
    rows : that our own first line states, or None; crc : its CRC-32 of the lines below it followed
        by `line`, its own start
    """

    device: Device = UNKNOWN
    rate: float | None = None
    start_ns: int | None = None
    notes: tuple[str, ...] = ()
    corrections: tuple[AppliedCalibration, ...] = ()
    serial: str = ""
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
    begin = DeviceStart(start_of(int(start.group(1)), notes) if start else None)
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
        serial=number[1] if (number := _SERIAL.search(text)) else "",
        units={q: u for q, u in {**units, **begin.units}.items() if u in _UNITS[q]},
        rows=int(own[2]) if own else None,
        line=own[1] if own else "",
        crc=_sum_of(own[3]) if own and own[3] is not None else None,
    )


def _sum_of(text: str) -> int:
    try:
        return int(text, 16)
    except ValueError:  # a damaged sum fits nothing
        return -1


@dataclass(frozen=True)
class Table:
    """What is known of a file before its columns are chosen.

    dialect : its shape
    facts : of the lines above the table
    mapping : what the user states
    pieces : the looks, without the lines above the table
    path : of the file, whose name tells a phone's sensors apart
    conditions : column from 0, and what the rows that are read hold there
    notes : what had to be chosen, filled meanwhile
    """

    dialect: Dialect
    facts: HeaderFacts
    mapping: FieldMapping
    pieces: Sequence[bytes]
    path: Path
    conditions: tuple[tuple[int, Condition], ...] = ()
    notes: list[str] = field(default_factory=list)

    @cached_property
    def rows(self) -> list[list[str]]:
        """The cells of some rows of every look."""
        rows = list[list[str]]()
        for piece in self.pieces:
            lines = piece.decode("utf-8", errors="replace").split("\n")[:-1]
            rows += map(self.dialect.cells, lines[:: max(1, len(lines) // _ROWS)])
        return [row for row in rows if len(row) >= self.dialect.width]

    @cached_property
    def columns(self) -> list[Meaning]:
        """What the names of the columns say; none where they have no names."""
        names, bare = self.dialect.names, bare_quantity(self.path.name.partition(".")[0])
        found = understand(names, bare)
        turned = bare == "angular_rate" and any(c.quantity for c in found)
        if turned and found != understand(names):
            self.notes.append("x, y, z are taken as an angular rate, by the name of the file")
        return found

    def numbers(self, columns: Sequence[int]) -> Array:
        """(n, k) numbers of some columns in the rows, NaN for what is none."""
        mark = self.dialect.decimal

        def number(cell: str) -> float:
            return float(cell.replace(mark, ".")) if is_number(cell, mark) else np.nan

        found = [[number(row[k]) for k in columns] for row in self.rows]
        return np.array(found).reshape(len(self.rows), len(columns))

    def contents(self, used: Container[int] = ()) -> list[Content]:
        """Every column of numbers that is not used with its median, those of a vector with its
        norm; where none is used, columns of text as well."""
        dialect = self.dialect
        names = [dialect.address(i) for i in range(dialect.width)]
        left = [i for i in range(dialect.width) if dialect.numeric[i] and i not in used]
        threes = [[left[k] for k in one] for one in triples_of([names[i] for i in left])]
        found = {}
        for three in threes:
            norm = norm_of(self.numbers(three))
            found[three[0]] = Content(", ".join(names[i] for i in three), "numbers", 0, norm=norm)
            left = [i for i in left if i not in three]
        for i in left:
            values = self.numbers((i,))
            finite = values[np.isfinite(values)]
            median = float(np.median(finite)) if finite.size else float("nan")
            found[i] = Content(names[i], "numbers", 0, median=median)
        for i, numeric in enumerate(dialect.numeric if not used else ()):
            if not numeric:
                example = next((row[i] for row in self.rows), "")
                found[i] = Content(names[i], f"text such as '{example[:30]}'", 0)
        return [found[i] for i in sorted(found)]

    def nothing_found(self) -> UnnamedColumns:
        """The error for a table in which no names tell of an acceleration or an angular rate: every
        column with its median, and every three neighbours whose norm is that of gravity."""
        dialect, vectors = self.dialect, list[Content]()
        for i in range(dialect.width - 2):
            if all(dialect.numeric[i : i + 3]):
                values = self.numbers(range(i, i + 3))
                if _is_gravity(values[np.isfinite(values).all(axis=1)]):
                    address = ",".join(map(dialect.address, range(i, i + 3)))
                    vectors.append(Content(address, "one vector?", 0, norm=norm_of(values)))
        what = f"the {dialect.width} columns have no names"
        option = vectors[0].address if len(vectors) == 1 else "X,Y,Z"
        return UnnamedColumns(
            ("no acceleration columns among" if dialect.names else what)
            + f":{listing([*self.contents(), *vectors])}\n",
            where=str(self.path),
            remedy=f"Name them: {paste('--acc', option)} (and --gyro, --time or --rate, --unit)",
        )

    def vectors(self) -> list[Vector]:
        """Those that the user names, those that the names tell, the temperature of the device."""
        stated = {}
        for quantity, option in OPTIONS.items():
            each = [column_index(n, self.dialect, option) for n in getattr(self.mapping, option)]
            width = 1 if quantity == "temperature" else 3
            if len(each) % width:
                raise UsageError(
                    f"{len(each)} columns do not make triads",
                    where=f"mapping: {option}",
                    remedy="name three columns for each sensor",
                )
            if each:
                stated[quantity] = [tuple(each[k : k + width]) for k in range(0, len(each), width)]
        numeric = self.dialect.numeric
        names = self.dialect.names or ("",) * self.dialect.width
        fields = [Field(name, int(n)) for name, n in zip(names, numeric, strict=True)]
        told = self.columns or understand(names)
        found = sorted(
            choose(fields, told, self.mapping, stated),
            key=lambda v: list(OPTIONS).index(v.quantity),
        )
        usual = self.facts.device.fields
        known = () if self.columns or "temperature" in stated else self._number(usual.temperature)
        warm = [Vector("temperature", "imu0", known, usual.temperature_unit)] if known else []
        return [*found, *warm]

    def _number(self, addresses: Sequence[str]) -> tuple[int, ...]:
        """Indices from 0 of a device's columns; none unless all are numbers that the table has."""
        width = self.dialect.width
        indices = tuple(int(a) - 1 for a in addresses if a.isdecimal() and int(a) <= width)
        return indices if len(indices) == len(addresses) else ()

    def time(self) -> tuple[tuple[int, ...], str, str]:
        """Columns of the stamps, the unit that the heading states, and the order of known parts."""
        names, columns = self.dialect.names, self.columns
        if self.mapping.time:
            indices = _addressed(self.mapping.time, self.dialect)
            order = parts_of_time([names[k] for k in indices]) if columns else {}
            known = "".join(order) if list(order.values()) == list(range(len(indices))) else ""
            return indices, columns[indices[0]].unit if columns else "", known
        if self.mapping.rate:
            return (), "", ""
        parts = parts_of_time(names)
        found = [c for c in columns if c.quantity == "time" and c.index not in parts.values()]
        # The index of a table may have no name.
        dates = [k for k, name in enumerate(names) if is_date(name) or not name]
        digits = [len(re.findall(r"\d+", cell)) for cell in self.dialect.example]
        if parts and not found:
            return tuple(parts.values()), "", "".join(parts)
        if not found:
            return tuple([k for k in dates if digits[k] >= 5][:1]), "", ""
        best = min(found, key=lambda c: "stamp" not in c.name.lower())
        at = best.index
        bare = not self.dialect.numeric[at] and ":" in self.dialect.example[at]
        if dates and bare and digits[at] <= 4:
            return (dates[0], at), "", ""
        return (at,), best.unit, ""

    def add_clocks(self, vectors: list[Vector]) -> list[Vector]:
        """The vectors with the column of stamps of each, where they do not share one: that which
        is named after its quantity, else the nearest to the left where some of one name stand
        between vectors (to the right, where the first one has none to its left)."""
        times = [c for c in self.columns if c.quantity == "time" and self.dialect.numeric[c.index]]
        main = [v for v in vectors if v.quantity != "temperature"]
        if any(c.triad for c in times):
            named = [[c.index for c in times if c.triad == v.quantity] for v in vectors]
            own = [at[0] if len(at) == 1 else -1 for at in named]
        else:
            first, last = min(v.parts[0] for v in main), max(v.parts[0] for v in main)
            alike = {re.sub(r"[\W\d_]+$", "", c.name.lower()) for c in times}
            if len(alike) > 1 or not any(first < c.index < last for c in times):
                return vectors
            right = not any(c.index < first for c in times)
            own = [_nearest([c.index for c in times], v.parts[0], right) for v in vectors]
        if len({at for at, v in zip(own, vectors, strict=True) if v in main}) < 2 or -1 in own:
            return vectors
        return [replace(v, clock=at) for v, at in zip(vectors, own, strict=True)]

    def time_without_names(self, vectors: Sequence[Vector]) -> tuple[int, ...]:
        """The time column of a table without names whose other columns the user has named."""
        used = {c for v in vectors for c in v.parts}
        known = self._number((self.facts.device.fields.time,))
        if known and known[0] not in used:
            return known
        if 0 not in used and (self.dialect.width == 1 + len(used) or not self.dialect.numeric[0]):
            self.notes.append("no column names: column 1 taken as time")
            return (0,)
        return ()

    def by_position(self) -> tuple[list[Vector], tuple[int, ...]]:
        """Columns of a table without (useful) names: a known device, or [date,] [time,] x, y, z and
        perhaps the three of the other sensor, which the norm of gravity tells apart."""
        dialect, fields = self.dialect, self.facts.device.fields
        if any(c.quantity for c in understand(dialect.names)):
            return [], ()
        if known := self._number(fields.acc):
            time = self._number((fields.time,))
            if not time and not dialect.numeric[known[0]]:  # some exports put a stamp in front
                known, time = tuple(k + 1 for k in known), (known[0],)
            if known[-1] < dialect.width:
                return [Vector("acceleration", "imu0", known)], time
        words = next((k for k, n in enumerate(dialect.numeric) if n), dialect.width)
        front = words or int(dialect.width in (4, 7))
        numbers, said = tuple(range(front, dialect.width)), "time, " * bool(front)
        found: list[Vector] = []
        if words <= 2 and all(dialect.numeric[words:]):
            if len(numbers) == 3:
                self.notes.append(f"no column names: taken as {said}x, y, z")
                found = [Vector("acceleration", "imu0", numbers)]
            elif len(numbers) == 6:
                found = self._two_sensors(numbers, said)
        return found, tuple(range(front)) if found else ()

    def _two_sensors(self, numbers: tuple[int, ...], said: str) -> list[Vector]:
        """Two triples of columns, of which one has the norm of gravity; else none."""
        halves = numbers[:3], numbers[3:]
        norms = [norm_of(self.numbers(at)) for at in halves]
        heavy = [Content("", "", 0, norm=norm).like_gravity for norm in norms]
        if sum(heavy) != 1:
            return []
        first = "accelerometer, gyroscope" if heavy[0] else "gyroscope, accelerometer"
        self.notes.append(f"no column names: taken as {said}{first}, by the norm of gravity")
        force, turn = halves if heavy[0] else halves[::-1]
        return [Vector("acceleration", "imu0", force), Vector("angular_rate", "imu0", turn)]


def _is_gravity(values: Array) -> bool:
    """Whether vectors (n, 3) hardly change their norm while each axis changes: gravity's mark."""
    if not values.size:
        return False
    low, middle, high = np.percentile(np.linalg.norm(values, axis=1), [25, 50, 75])
    turns = (np.ptp(values, axis=0) > 0.2 * middle).all()
    return bool(middle > 0 and turns and high - low < 0.05 * middle)


@dataclass(frozen=True)
class Selection:
    """Vectors to read; time : column, those that make a stamp together, or none; time_unit as the
    name states it; time_order : of the parts of a stamp, where these are known."""

    vectors: tuple[Vector, ...]
    time: tuple[int, ...]
    time_unit: str
    time_order: str = ""


def select(table: Table) -> Selection:
    """Choose the columns: none when neither an acceleration nor an angular rate is found. Raises
    UsageError for a column that is not there."""
    dialect, facts = table.dialect, table.facts
    table = replace(table, mapping=_of_device(table.mapping, facts.device, dialect))
    every = table.vectors()
    vectors = [v for v in every if v.quantity != "temperature"]
    time, time_unit, order = table.time()
    free = not time and not table.mapping.rate and not table.columns
    if vectors and free:
        time = table.time_without_names(vectors)
    if not vectors:
        vectors, guessed = table.by_position()
        time = guessed if free else time
        every = [*vectors, *every]
    if not vectors:
        return Selection((), (), "")
    if len(time) > 1:
        names = ", ".join(dialect.names[k] if dialect.names else str(k + 1) for k in time)
        table.notes.append(f"time: columns {names} taken together")
    every = [v if v.quantity == "temperature" else _add_unit(v, facts) for v in every]
    if len(time) == 1 and not table.mapping.time:
        every = table.add_clocks(every)
    return Selection(tuple(every), time, time_unit, order)


def _of_device(mapping: FieldMapping, device: Device, dialect: Dialect) -> FieldMapping:
    """The mapping, with the columns that the device names where the user names none and the table
    has them."""
    names = {*dialect.names, *(c.name for c in understand(dialect.names))}
    usual = {option: getattr(device.fields, option) for option in OPTIONS.values()}
    known = {option: each for option, each in usual.items() if names.issuperset(each)}
    if device.fields.time in names and not mapping.rate:
        known["time"] = device.fields.time
    return mapping if mapping.acc or mapping.gyro else mapping.fill_from(FieldMapping(**known))


def by_clock(selection: Selection, columns: Sequence[Meaning]) -> list[Selection]:
    """What is read by each clock of a table whose sensors have their own."""
    clocks = list(dict.fromkeys(v.clock for v in selection.vectors))
    if clocks == [-1]:
        return [selection]
    return [
        replace(
            selection,
            vectors=tuple(v for v in selection.vectors if v.clock == clock),
            time=(clock,),
            time_unit=columns[clock].unit,
        )
        for clock in clocks
    ]


def _nearest(times: Sequence[int], column: int, right: bool) -> int:
    side = [k for k in times if (k > column if right else k < column)]
    return (min if right else max)(side, default=-1)


def _add_unit(vector: Vector, facts: HeaderFacts) -> Vector:
    """The vector with the unit that the lines above the table state; with both, where its heading
    states another: no unit that is known, which is refused. Where neither does, its device's."""
    above = facts.units.get(vector.quantity)
    if above and {canonical(part) for part in vector.unit.split(",")} != {above}:
        both = f"{above} (above the table; {vector.unit} in the heading)"
        return replace(vector, unit=both if vector.unit else above)
    fields = facts.device.fields
    usual = fields.acc_unit if vector.quantity == "acceleration" else fields.gyro_unit
    return replace(vector, unit=vector.unit or usual)


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


def _addressed(text: str, dialect: Dialect) -> tuple[int, ...]:
    """The columns of a stamp: one name, which may hold a comma, or several."""
    try:
        return (column_index(text, dialect, "time"),)
    except UsageError:
        if "," not in text:
            raise
    return tuple(column_index(part, dialect, "time") for part in text.split(","))
