"""Everything that must be known before the first block: columns, clock, units; from a few looks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers import conversion
from imucalib.readers.conversion import Conversion
from imucalib.readers.csv.rows import Layout, Rows, parse
from imucalib.readers.csv.select import (
    HeaderFacts,
    Selection,
    Stated,
    Vector,
    column_index,
    facts_of,
    nothing_found,
    rows_of,
    select,
)
from imucalib.readers.csv.stamps import MISSING, TextTime, text_layout, text_to_ns
from imucalib.readers.csv.text import (
    Condition,
    Dialect,
    Lines,
    cells_of,
    demand_some,
    is_blank,
    looks,
    parted,
    sniff,
    told,
)
from imucalib.readers.devices.catalogue import Device
from imucalib.readers.timebase import (
    Stepping,
    clock_unit,
    contradicts,
    date_of,
    known_unit,
    seconds_of,
    stepping,
)
from imucalib.recording.mapping import TIME_UNITS, FieldMapping
from imucalib.recording.recording import Correction

#: What headings of stamps have in brackets that is no unit.
_NO_UNIT = {"iso 8601", "unix time", "posix time", "unix epoch"} | set(
    str.split("unix epoch posix utc gmt local iso iso8601 cal raw time")
)


@dataclass(frozen=True)
class Stamps:
    """Of the looks: all rows, those where the main channel has a value, and stamps as text."""

    rows: tuple[Rows, ...]
    main: tuple[Rows, ...]
    texts: tuple[bytes, ...]


@dataclass(frozen=True)
class Clock:
    """Maps stamps to seconds since the start.

    kind : "int", "float", "text", or "" for row number / rate
    unit : key of TIME_UNITS or "text"; origin : stamp of t = 0, in the stamps' own unit
    typical : rows that share one stamp of step `resolution` (s), when stamps are that coarse
    looks : times of the looks, s
    """

    kind: str
    unit: str
    origin: float | int
    start_ns: int | None
    rate: float
    threshold: float
    text: TextTime | None = None
    resolution: float = 0.0
    typical: float = 0.0
    looks: tuple[Array, ...] = ()

    def seconds(self, stamps: NDArray[np.generic]) -> tuple[Array, NDArray[np.bool_]]:
        """Seconds since the start of parsed stamps (n,), NaN where blank; and which stamps are not
        understood."""
        wrong = np.zeros(stamps.shape, dtype=np.bool_)
        if self.text is not None:
            stamps, wrong = text_to_ns(stamps.astype(np.bytes_), self.text)
        return seconds_of(stamps, self.origin, self.unit, MISSING), wrong


def clock_of(
    selection: Selection,
    layout: Layout,
    mapping: FieldMapping,
    facts: HeaderFacts,
    *,
    known: Stamps,
    where: str,
) -> tuple[Clock, list[str]]:
    """The clock, and what had to be found out about it. Raises UnreadableInput without a rate."""
    if not layout.time_kind:
        return _by_rate(mapping.rate or facts.rate, facts, known.rows, where)
    return _by_stamps(selection, layout, mapping, facts, known=known, where=where)


def _by_rate(
    rate: float | None, facts: HeaderFacts, parsed: Sequence[Rows], where: str
) -> tuple[Clock, list[str]]:
    if not rate:
        raise UnreadableInput(
            "the file has neither time stamps nor a sample rate",
            where=where,
            remedy="give --rate, or --time",
        )
    looks = tuple(np.arange(rows.values.shape[0]) / rate for rows in parsed)
    clock = Clock("", "", 0, facts.start_ns, rate, 1.75 / rate, looks=looks)
    return clock, [f"time: row number at {rate:.6g} Hz"]


def _by_stamps(
    selection: Selection,
    layout: Layout,
    mapping: FieldMapping,
    facts: HeaderFacts,
    *,
    known: Stamps,
    where: str,
) -> tuple[Clock, list[str]]:
    kind, notes = layout.time_kind, []
    text = _text_of(selection, mapping, known, where) if kind == "text" else None
    stated = mapping.time_unit or (
        "" if selection.time_unit.lower() in _NO_UNIT else selection.time_unit
    )
    unit, epoch = ("text", None) if text else clock_unit(stated, where)
    raw = [_numbers(rows.stamps, text, where) for rows in known.rows]
    main = [_numbers(rows.stamps, text, where) for rows in known.main]
    first = next((s[k][0].item() for s in raw for k in [_known(s)] if k.any()), None)
    if first is None:
        raise UnreadableInput("the time column holds no stamps", where=where, remedy="give --rate")
    steps = stepping([seconds_of(s, first, "s", MISSING) for s in main])
    if steps is None:
        raise UnreadableInput("the time stamps never advance", where=where, remedy="give --rate")
    if not text:
        who, stated_rate = "the heading", facts.rate
        unit, note = known_unit(unit, first, steps.step, where, who=who, stated=stated_rate)
        notes += [note] * bool(note)
    size = TIME_UNITS.get(unit, 1e-9)
    start = (int(first) if text.dated else None) if text else date_of(first, unit, epoch)
    origin = 0 if start is None else first
    start_ns = facts.start_ns if start is None or (text and text.ambiguous) else start
    if text:
        notes += _text_notes(text)
    looks = tuple(seconds_of(s, origin, unit, MISSING) for s in raw)
    steps = Stepping(steps.step * size, steps.threshold * size)
    clock = Clock(
        kind=kind,
        unit=unit,
        origin=origin,
        start_ns=start_ns,
        rate=1.0 / steps.step,
        threshold=steps.threshold,
        text=text,
        looks=looks,
    )
    coarse = _coarse(clock, looks, steps)
    if coarse is not clock:
        notes.append(
            f"time: stamps have a resolution of {steps.step:.6g} s; the rows that share one "
            f"(about {coarse.typical:.4g}) are spread evenly over it"
        )
    asked = mapping.time or mapping.time_unit
    if facts.rate and not asked and contradicts(coarse.rate, facts.rate):
        raise UnreadableInput(
            f"the lines above the table state {facts.rate:g} Hz, the time stamps in "
            f"{coarse.unit} advance with {coarse.rate:.4g} Hz",
            where=where,
            remedy=f"--rate {facts.rate:g} takes the former, --time-unit {coarse.unit} the latter",
        )
    return coarse, notes


def _text_of(selection: Selection, mapping: FieldMapping, known: Stamps, where: str) -> TextTime:
    """What stamps as text are made of: parts in columns of their own have a known order."""
    if selection.time_order:
        fraction = "f" * any(b"." in s.split()[-1] for s in known.texts if s)
        order = selection.time_order
        return TextTime(order if order[-1] in "iu" else order + fraction, True)
    return text_layout(list(known.texts), mapping.time_format, where)


def _numbers(stamps: NDArray[np.generic], text: TextTime | None, where: str) -> NDArray[Any]:
    """Stamps as numbers; those of bad rows, which are told when they are read, are blank here."""
    if text is None:
        return stamps
    ns, wrong = text_to_ns(stamps.astype(np.bytes_), text)
    if 2 * np.count_nonzero(wrong) > wrong.size:
        raise bad_stamp(Rows(stamps, np.empty((0, 0))), int(np.argmax(wrong)), 0, where)
    return ns


def bad_stamp(rows: Rows, index: int, line: int, where: str) -> UnreadableInput:
    """The error for a text stamp that is not understood; `line` is the first row's line, or 0."""
    stamp = bytes(rows.stamps[index]).decode(errors="replace")
    line = int(rows.lines[index]) if rows.lines is not None else line and line + index
    return UnreadableInput(
        f"the time stamp '{stamp[:40]}' is not understood",
        where=f"{where}: line {line}" if line else where,
        remedy="correct or delete that line, or give --time-format",
    )


def _known(stamps: NDArray[Any]) -> NDArray[np.bool_]:
    return stamps != MISSING if stamps.dtype.kind == "i" else np.isfinite(stamps.astype(np.float64))


def _text_notes(text: TextTime) -> list[str]:
    if not text.dated:
        what = "midnight" if text.period > 3600.0 else "the end of an hour"
        return [f"time: stamps have no date, {what} is bridged"]
    notes = [] if text.zone else ["time: stamps have no zone, taken as UTC"]
    if text.ambiguous:
        notes.append("time: day and month cannot be told apart, no start date is kept")
    return notes


def _coarse(clock: Clock, looks: Sequence[Array], steps: Stepping) -> Clock:
    """The clock with rows spread over their stamp, when most rows share one with the row before."""
    same = np.concatenate([np.diff(t) == 0 for t in looks])
    if same.size == 0 or same.mean() <= 0.5:
        return clock
    counts: list[int] = []
    for t in looks:
        edges = np.flatnonzero(np.diff(t) != 0)
        counts.extend(np.diff(edges).tolist())
    typical = float(np.median(counts)) if counts else float(same.sum() + 1)
    rate = typical / steps.step
    return Clock(
        kind=clock.kind,
        unit=clock.unit,
        origin=clock.origin,
        start_ns=clock.start_ns,
        rate=rate,
        threshold=1.75 * steps.step,
        text=clock.text,
        resolution=steps.step,
        typical=typical,
        looks=clock.looks,
    )


_REST_SECONDS = 0.5  # window of the look for rest that finds the unit


@dataclass(frozen=True)
class Signal:
    """One channel: its position among the parsed values, its conversion, its own clock.

    rate : Hz; threshold : a longer step is a gap, s
    """

    name: str
    quantity: str
    triad: str
    at: tuple[int, ...]
    conversion: Conversion
    rate: float
    threshold: float


@dataclass(frozen=True)
class Plan:
    """How to read one file.

    conditions : what the rows that are read hold
    idle : rows of zeros mean "not recorded"; stated : of its rows, by our own first line
    corrections : as in Recording
    """

    dialect: Dialect
    layout: Layout
    clock: Clock
    signals: tuple[Signal, ...]
    idle: bool
    notes: tuple[str, ...]
    resolved: FieldMapping
    stated: Stated | None = None
    corrections: tuple[Correction, ...] = ()
    conditions: tuple[Condition, ...] = ()

    def chosen(self, lines: Lines) -> Lines:
        """The lines below the heading that hold what was asked for."""
        return _chosen(lines, self.conditions, self.dialect)


def _chosen(lines: Lines, conditions: Sequence[Condition], dialect: Dialect) -> Lines:
    if not conditions:
        return lines
    kept, numbers = [], []
    for number, line in enumerate(lines.data.split(b"\n")[:-1], start=lines.first_line):
        row = cells_of(line.decode("utf-8", errors="replace"), dialect.delimiter)
        if all(c.column < len(row) and c.fits(row[c.column]) for c in conditions):
            kept.append(line + b"\n")
            numbers.append(number)
    return Lines(b"".join(kept), lines.first_line, lines.note, tuple(numbers))


def make_plan(path: Path, mapping: FieldMapping) -> Plan:
    """Look at the file's start, middle and end, and decide. Errors as in `readers.read`."""
    where = str(path)
    pieces = looks(path)
    if not pieces:
        raise UnreadableInput(
            "the file holds no whole line of text",
            where=where,
            remedy="copy it again from its source: it is empty, cut off, or packed and damaged",
        )
    dialect = sniff(pieces, mapping, where)
    facts = facts_of(dialect.preamble, where)
    conditions = tuple(
        Condition(column_index(c, dialect, "where"), v) for c, v in map(parted, mapping.where)
    )
    said = _columns_told(dialect, pieces) if not conditions else []
    if conditions:
        pieces = _pieces_chosen(pieces, conditions, dialect, mapping, where)
        facts = replace(facts, stated=None)
    selection = select(dialect, mapping, facts, pieces, path.name)
    if not selection.vectors:
        raise nothing_found(dialect, pieces, where)
    layout, samples = _layout(dialect, selection, pieces)
    parsed = _parse_looks(pieces, layout, dialect, where)
    main = [np.isfinite(_values(selection.vectors[0], layout, r)).all(axis=1) for r in parsed]
    stamped = [
        Rows(r.stamps[k] if r.stamps.size else r.stamps, r.values[k])
        for r, k in zip(parsed, main, strict=True)
    ]
    known = Stamps(tuple(parsed), tuple(stamped), tuple(samples))
    clock, clock_notes = clock_of(selection, layout, mapping, facts, known=known, where=where)
    used = [v for v in selection.vectors if _has_values(v, layout, parsed)]
    notes = [*facts.notes, *selection.notes, *clock_notes, *said]
    notes += [
        f"{v.triad}/{v.quantity} left out: no values" for v in selection.vectors if v not in used
    ]
    if not any(v.quantity != "temperature" for v in used):
        raise UnreadableInput("the chosen columns hold no values", where=where)
    dev = facts.device
    signals = conversion.readable(
        used,
        lambda v: _signal(v, layout, parsed, mapping, clock=clock, device=dev, where=where),
        notes,
    )
    notes += [s.conversion.note for s in signals if s.conversion.note]
    resolved = _resolved(mapping, dialect, selection, signals, clock=clock, device=dev.name)
    unique = tuple(dict.fromkeys(notes))
    return Plan(
        dialect=dialect,
        layout=layout,
        clock=clock,
        signals=signals,
        idle=dev.sleeps,
        notes=unique,
        resolved=resolved,
        stated=facts.stated,
        corrections=facts.corrections,
        conditions=conditions,
    )


def _pieces_chosen(
    pieces: Sequence[bytes],
    conditions: Sequence[Condition],
    dialect: Dialect,
    mapping: FieldMapping,
    where: str,
) -> list[bytes]:
    """The looks without the rows that are not asked for. Raises UnreadableInput for none."""
    lines = pieces[0].split(b"\n")
    above = b"".join(line + b"\n" for line in lines[: dialect.data_line - 1])
    below = [b"\n".join(lines[dialect.data_line - 1 :]), *pieces[1:]]
    kept = [_chosen(Lines(p, 1), conditions, dialect).data for p in below]
    rows = rows_of(dialect, pieces)
    cells = [[row[c.column] for row in rows] for c in conditions]
    demand_some(sum(map(len, kept)), mapping.where, cells, where)
    return [above + kept[0], *filter(None, kept[1:])]


def _columns_told(dialect: Dialect, pieces: Sequence[bytes]) -> list[str]:
    """Sentences on columns of a few words, which may be of more than one sensor."""
    if not dialect.names:
        return []
    rows = rows_of(dialect, pieces)
    every = (told(name, [row[k] for row in rows]) for k, name in enumerate(dialect.names))
    return [sentence for sentence in every if sentence]


def _layout(
    dialect: Dialect, selection: Selection, pieces: Sequence[bytes]
) -> tuple[Layout, list[bytes]]:
    """The layout, and up to 40 stamps of each look as text."""
    samples: list[bytes] = []
    if selection.time:
        for number, piece in enumerate(pieces):
            lines = piece.decode("utf-8", errors="replace").split("\n")[:-1]
            lines = lines[dialect.data_line - 1 :] if number == 0 else lines
            for line in lines[:20] + lines[-20:]:
                row = cells_of(line, dialect.delimiter)
                if len(row) == dialect.width and not any(is_blank(row[k]) for k in selection.time):
                    samples.append(" ".join(row[k] for k in selection.time).encode())
    columns = tuple(dict.fromkeys(c for v in selection.vectors for c in v.columns))
    kind = _time_kind(dialect, selection.time, samples)
    time = selection.time if kind else ()
    width = max((len(s) for s in samples), default=0) + 16
    layout = Layout(
        delimiter=dialect.delimiter,
        decimal=dialect.decimal,
        width=dialect.width,
        time=time,
        time_kind=kind,
        values=columns,
        text_width=width,
    )
    return layout, samples


def _time_kind(dialect: Dialect, time: tuple[int, ...], samples: list[bytes]) -> str:
    if not samples:
        return ""
    if len(time) > 1 or not dialect.numeric[time[0]]:
        return "text"
    integers = sum(s.lstrip(b"+-").isdigit() for s in samples)
    return "int" if 2 * integers > len(samples) else "float"


def _parse_looks(
    pieces: Sequence[bytes], layout: Layout, dialect: Dialect, where: str
) -> list[Rows]:
    """Parsed looks; one that holds a bad cell is passed over here and reported when it is read."""
    first = pieces[0].split(b"\n")[dialect.data_line - 1 :]
    parsed = [parse(Lines(b"\n".join(first), dialect.data_line), layout, where)]
    for piece in pieces[1:]:
        try:
            parsed.append(parse(Lines(piece, 0), layout, where))
        except UnreadableInput:
            continue
    return [rows for rows in parsed if rows.values.size]


def _values(vector: Vector, layout: Layout, rows: Rows) -> Array:
    at = [layout.values.index(c) for c in vector.columns]
    return rows.values[:, at]


def _has_values(vector: Vector, layout: Layout, parsed: Sequence[Rows]) -> bool:
    return any(np.isfinite(_values(vector, layout, r)).all(axis=1).any() for r in parsed)


def _signal(
    vector: Vector,
    layout: Layout,
    parsed: Sequence[Rows],
    mapping: FieldMapping,
    *,
    clock: Clock,
    device: Device,
    where: str,
) -> Signal:
    raw = [_values(vector, layout, rows) for rows in parsed]
    known = [np.isfinite(v).all(axis=1) for v in raw]
    rate, threshold = clock.rate, clock.threshold
    if clock.kind and not clock.resolution:
        steps = stepping([t[k] for t, k in zip(clock.looks, known, strict=True)])
        rate, threshold = (1.0 / steps.step, steps.threshold) if steps else (rate, threshold)
    if vector.quantity == "acceleration":
        window = max(3, round(_REST_SECONDS * rate))
        rest = conversion.readings_at_rest([v[k] for v, k in zip(raw, known, strict=True)], window)
        whole = all((v[k] == np.rint(v[k])).all() for v, k in zip(raw, known, strict=True))
        source = conversion.Source(vector.unit, device.scales, whole)
        how = conversion.acceleration(mapping, source, rest, f"{where}: {vector.triad}")
    elif vector.quantity == "angular_rate":
        how = conversion.angular_rate(mapping, vector.unit, where)
    else:
        how = conversion.temperature(mapping, vector.unit, np.concatenate(raw)[:, 0], where)
    name = f"{vector.triad}/{vector.quantity}"
    at = tuple(layout.values.index(c) for c in vector.columns)
    return Signal(
        name=name,
        quantity=vector.quantity,
        triad=vector.triad,
        at=at,
        conversion=how,
        rate=rate,
        threshold=threshold,
    )


def _triads(selection: Selection) -> tuple[str, ...]:
    """Names in the order of the accelerometers, then of the gyroscopes if these differ."""
    acc = [v.triad for v in selection.vectors if v.quantity == "acceleration"]
    gyro = [v.triad for v in selection.vectors if v.quantity == "angular_rate"]
    return tuple(acc if gyro == acc[: len(gyro)] else acc + gyro)


def _resolved(
    mapping: FieldMapping,
    dialect: Dialect,
    selection: Selection,
    signals: Sequence[Signal],
    *,
    clock: Clock,
    device: str,
) -> FieldMapping:
    """The mapping that reads this file, and others like it, the same way."""

    def addresses(quantity: str) -> tuple[str, ...]:
        chosen = [v for v in selection.vectors if v.quantity == quantity]
        return tuple(dialect.address(c) for v in chosen for c in v.columns)

    def unit(quantity: str) -> str:
        found = {s.conversion.source_unit for s in signals if s.quantity == quantity}
        return found.pop() if len(found) == 1 else ""

    # Counts a g that the device was found to have.
    scales = {s.conversion.counts_per_g for s in signals if s.conversion.counts_per_g}
    return replace(
        mapping,
        acc=addresses("acceleration"),
        gyro=addresses("angular_rate"),
        temperature=addresses("temperature"),
        time=",".join(map(dialect.address, selection.time)) if clock.kind else "",
        triads=_triads(selection),
        acc_unit=unit("acceleration"),
        gyro_unit=unit("angular_rate"),
        temperature_unit=unit("temperature"),
        rate=None if clock.kind else clock.rate,
        time_unit="" if " since " in selection.time_unit else clock.unit,
        decimal=dialect.decimal,
        delimiter=dialect.delimiter,
        preset=mapping.preset or device,
        lsb_per_g=mapping.lsb_per_g or (tuple(scales) if len(scales) == 1 else ()),
    )
