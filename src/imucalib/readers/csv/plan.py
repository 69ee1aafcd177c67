"""Everything that must be known before the first block: columns, clock, units; from a few looks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Flags
from imucalib.errors import UnreadableInput
from imucalib.question import paste
from imucalib.readers.csv.dialect import Dialect, sniff
from imucalib.readers.csv.rows import ParsedRows, TableLayout, parse
from imucalib.readers.csv.select import (
    Selection,
    Table,
    by_clock,
    column_index,
    facts_of,
    select,
)
from imucalib.readers.csv.stamps import MISSING, TextTime, text_layout, text_to_ns
from imucalib.readers.csv.text import (
    Condition,
    Lines,
    few_values,
    is_blank,
    looks,
    no_row_has,
    take_turns,
)
from imucalib.readers.fields import conversion
from imucalib.readers.fields.choice import Vector, resolve_mapping
from imucalib.readers.fields.contents import describe_unread
from imucalib.readers.fields.conversion import Conversion
from imucalib.readers.fields.timebase import (
    contradicts,
    date_of,
    measure_steps,
    seconds_of,
    stamps_of,
)
from imucalib.recording.mapping import TIME_UNITS, FieldMapping

_ADJACENT = 200  # rows that show whether those of devices take turns
_SAMPLES = 20  # stamps from each end of a look
#: What headings of stamps have in brackets that is no unit.
_NO_UNIT = {"iso 8601", "unix time", "posix time", "unix epoch"} | set(
    str.split("unix epoch posix utc gmt local iso iso8601 cal raw time")
)


@dataclass(frozen=True)
class TableClock:
    """Maps stamps to seconds since the start.

    unit : key of TIME_UNITS or "text", or "" for row number / rate
    origin : stamp of t = 0, in the stamps' own unit
    threshold : a longer step is a gap, s
    typical : rows that share one stamp of step `resolution` (s), when stamps are that coarse
    """

    unit: str
    origin: float | int
    start_ns: int | None
    rate: float
    threshold: float
    text: TextTime | None = None
    resolution: float = 0.0
    typical: float = 0.0

    def seconds(self, stamps: NDArray[np.generic]) -> tuple[Array, Flags]:
        """Seconds since the start of parsed stamps (n,), NaN where blank; and which stamps are not
        understood."""
        numbers, wrong = _numbers(stamps, self.text)
        return seconds_of(numbers, self.origin, self.unit, MISSING), wrong


@dataclass(frozen=True)
class TableSignal:
    """One channel: its position among the parsed values, its conversion, its own clock.

    rate : Hz; threshold : a longer step is a gap, s
    """

    vector: Vector
    at: tuple[int, ...]
    conversion: Conversion
    rate: float
    threshold: float


@dataclass(frozen=True)
class TablePlan:
    """How to read one file.

    resolved : the mapping that reads it so again
    """

    table: Table
    layout: TableLayout
    clock: TableClock
    signals: tuple[TableSignal, ...]
    notes: tuple[str, ...]
    resolved: FieldMapping

    def rows_in(self, lines: Lines) -> Lines:
        """The lines without those above the table, and without rows that are not wanted."""
        dialect = self.table.dialect
        return _choose(lines.from_line(dialect.data_line), self.table.conditions, dialect)


def _choose(lines: Lines, conditions: Sequence[tuple[int, Condition]], dialect: Dialect) -> Lines:
    if not conditions:
        return lines
    kept, numbers = [], []
    for number, line in enumerate(lines.data.split(b"\n")[:-1], start=lines.first_line):
        row = dialect.cells(line.decode("utf-8", errors="replace"))
        if all(at < len(row) and c.fits(row[at]) for at, c in conditions):
            kept.append(line + b"\n")
            numbers.append(number)
    return replace(lines, data=b"".join(kept), numbers=tuple(numbers))


def make_plans(path: Path, mapping: FieldMapping) -> list[TablePlan]:
    """Look at the file's start, middle and end, and decide: one plan, or one for each clock where
    sensors have their own. Errors as in `readers.read`."""
    where = str(path)
    pieces = looks(path)
    if not pieces:
        raise UnreadableInput(
            "the file holds no whole line of text",
            where=where,
            remedy="copy it again from its source: it is empty, cut off, or packed and damaged",
        )
    dialect = sniff(pieces, mapping, where)
    wanted = map(Condition.of, mapping.where)
    conditions = tuple((column_index(c.name, dialect, "where"), c) for c in wanted)
    facts = facts_of(dialect.preamble, where)
    if conditions:
        facts = replace(facts, rows=None, crc=None)
    pieces[0] = Lines(pieces[0], 1).from_line(dialect.data_line).data
    table = Table(dialect, facts, mapping, pieces, path, conditions)
    if conditions:
        table = replace(table, pieces=_pieces_chosen(table))
    else:
        _demand_one_device(dialect, pieces[0], where)
    selection = select(table)
    if not selection.vectors:
        raise table.nothing_found()
    used = {k for v in selection.vectors for k in (*v.parts, v.clock)} | set(selection.time)
    used |= {at for at, _ in conditions}
    table.notes.extend([] if conditions else _columns_of_words(table))
    if dialect.more:
        some = ", ".join(dialect.more)
        table.notes.append(f"not read, since only some rows have it: {some}")
    table.notes.extend(describe_unread(table.contents(used)))
    plans = [_plan(table, one) for one in by_clock(selection, table.columns)]
    main = plans[0].clock
    dated = {(p.clock.unit, p.clock.start_ns is None) for p in plans}
    if len(dated) > 1:
        raise UnreadableInput(
            "the clocks of its sensors count from different starts",
            where=where,
            remedy="read one sensor with --acc or --gyro and its own --time",
        )
    whole = _resolve(table, plans, selection)
    clocks = [replace(p.clock, origin=main.origin, start_ns=main.start_ns) for p in plans]
    return [replace(p, resolved=whole, clock=c) for p, c in zip(plans, clocks, strict=True)]


def _plan(table: Table, selection: Selection) -> TablePlan:
    """What is read by one clock."""
    facts, mapping, where = table.facts, table.mapping, str(table.path)
    layout, stamps = _layout(table, selection)
    parsed = _parse_looks(table.pieces, layout, where)
    if layout.kind:
        main = [(r, _has_all(selection.vectors[0], layout, r)) for r in parsed]
        clock, clock_notes = clock_by_stamps(table, selection, main, stamps, layout.kind)
    else:
        clock, clock_notes = clock_by_rate(mapping.rate or facts.rate, facts.start_ns, where)
    notes = [*facts.notes, *table.notes, *clock_notes]
    used = [v for v in selection.vectors if any(_has_all(v, layout, r).any() for r in parsed)]
    notes += [f"{v.name} left out: no values" for v in selection.vectors if v not in used]
    if not any(v.quantity != "temperature" for v in used):
        raise UnreadableInput("the chosen columns hold no values", where=where)
    signals = conversion.make_readable(
        used, lambda v: _signal(v, table, layout, parsed, clock), notes
    )
    notes += [s.conversion.note for s in signals if s.conversion.note]
    unique = tuple(dict.fromkeys(notes))
    return TablePlan(table, layout, clock, signals, unique, mapping)


def _pieces_chosen(table: Table) -> list[bytes]:
    """The looks without the rows that are not wanted. Raises UnreadableInput for none."""
    conditions = table.conditions
    kept = [_choose(Lines(p, 1), conditions, table.dialect).data for p in table.pieces]
    if not any(kept):
        cells = [[row[at] for row in table.rows] for at, _ in conditions]
        raise no_row_has(table.mapping.where, cells, str(table.path))
    return [kept[0], *filter(None, kept[1:])]


def _demand_one_device(dialect: Dialect, piece: bytes, where: str) -> None:
    """Raise UnreadableInput for a table in which rows of several devices take turns."""
    lines = piece.decode("utf-8", errors="replace").split("\n")
    each = [dialect.cells(line) for line in lines[:_ADJACENT]]
    rows = [row for row in each if len(row) == dialect.width]
    for k, name in enumerate(dialect.names if len(rows) > 1 else ()):
        cells = [row[k] for row in rows]
        if take_turns(name, cells, dialect.decimal):
            said = few_values(name, cells, dialect.decimal)
            raise UnreadableInput(
                f"rows of several sensors take turns: {said.partition(' (')[0]}",
                where=where,
                remedy=f"read one of them: {paste('--where', f'{name}={cells[0]}')}",
            )


def _columns_of_words(table: Table) -> list[str]:
    """Sentences on columns of a few words, which may be of more than one sensor."""
    every = (
        few_values(name, [row[k] for row in table.rows], table.dialect.decimal)
        for k, name in enumerate(table.dialect.names)
    )
    return [sentence for sentence in every if sentence]


def _layout(table: Table, selection: Selection) -> tuple[TableLayout, list[bytes]]:
    """The layout, and some stamps of each look as text."""
    dialect = table.dialect
    samples: list[bytes] = []
    for piece in table.pieces if selection.time else ():
        lines = piece.decode("utf-8", errors="replace").split("\n")[:-1]
        for line in lines[:_SAMPLES] + lines[-_SAMPLES:]:
            row = dialect.cells(line)
            if len(row) == dialect.width and not any(is_blank(row[k]) for k in selection.time):
                samples.append(" ".join(row[k] for k in selection.time).encode())
    if not samples:
        kind = ""
    elif len(selection.time) > 1 or not dialect.numeric[selection.time[0]]:
        kind = "text"
    else:
        integers = sum(s.lstrip(b"+-").isdigit() for s in samples)
        kind = "int" if 2 * integers > len(samples) else "float"
    columns = tuple(dict.fromkeys(c for v in selection.vectors for c in v.parts))
    width = max((len(s) for s in samples), default=0) + 16
    return TableLayout(dialect, selection.time if kind else (), kind, columns, width), samples


def _parse_looks(pieces: Sequence[bytes], layout: TableLayout, where: str) -> list[ParsedRows]:
    """Parsed looks; one that holds a bad cell is passed over here and reported when it is read."""
    parsed = [parse(Lines(pieces[0], layout.dialect.data_line), layout, where)]
    for piece in pieces[1:]:
        try:
            parsed.append(parse(Lines(piece, 0), layout, where))
        except UnreadableInput:
            continue
    return [rows for rows in parsed if rows.values.size]


def _places(vector: Vector, layout: TableLayout) -> tuple[int, ...]:
    """Of a vector's columns among the parsed values."""
    return tuple(layout.values.index(c) for c in vector.parts)


def _has_all(vector: Vector, layout: TableLayout, rows: ParsedRows) -> Flags:
    return np.asarray(np.isfinite(rows.values[:, _places(vector, layout)]).all(axis=1))


def _signal(
    vector: Vector,
    table: Table,
    layout: TableLayout,
    parsed: Sequence[ParsedRows],
    clock: TableClock,
) -> TableSignal:
    at = _places(vector, layout)
    raw: list[Array] = [rows.values[:, at] for rows in parsed]
    known = [np.isfinite(v).all(axis=1) for v in raw]
    whole = [v[k] for v, k in zip(raw, known, strict=True)]
    rate, threshold = clock.rate, clock.threshold
    if clock.unit and not clock.resolution:
        times = (clock.seconds(rows.stamps)[0] for rows in parsed)
        steps = measure_steps([t[k] for t, k in zip(times, known, strict=True)])
        rate, threshold = (1.0 / steps.step, steps.threshold) if steps else (rate, threshold)
    source = conversion.UnitSource(vector.unit, table.facts.device.scales)
    where = (
        f"{table.path}: {vector.triad}" if vector.quantity == "acceleration" else str(table.path)
    )
    how = conversion.find_conversion(
        vector.quantity, table.mapping, source, whole, rate=rate, where=where
    )
    return TableSignal(vector, at, how, rate, threshold)


def _numbers(
    stamps: NDArray[np.generic], text: TextTime | None
) -> tuple[NDArray[np.generic], Flags]:
    if text is None:
        return stamps, np.zeros(stamps.shape, dtype=np.bool_)
    return text_to_ns(stamps.astype(np.bytes_), text)


def clock_by_rate(
    rate: float | None, start_ns: int | None, where: str
) -> tuple[TableClock, list[str]]:
    """A clock that counts rows, and the sentence that says so."""
    if not rate:
        raise UnreadableInput(
            "the file has neither time stamps nor a sample rate",
            where=where,
            remedy="give --rate, or --time",
        )
    return TableClock("", 0, start_ns, rate, 1.75 / rate), [f"time: row number at {rate:.6g} Hz"]


def clock_by_stamps(
    table: Table,
    selection: Selection,
    pieces: Sequence[tuple[ParsedRows, Flags]],
    texts: Sequence[bytes],
    kind: str,
) -> tuple[TableClock, list[str]]:
    """The clock, and what had to be found out about it. Raises UnreadableInput where it cannot be.

    pieces : rows of the looks, and those where the main channel has a value
    texts : some stamps; kind : of them, as in `Layout`
    """
    mapping, facts, where = table.mapping, table.facts, str(table.path)
    text = _text_of(selection, mapping, texts, where) if kind == "text" else None
    heading = "" if selection.time_unit.lower() in _NO_UNIT else selection.time_unit
    stamps = [_understood(rows, text, where) for rows, _ in pieces]
    main = [s[k & _known(s)] for s, (_, k) in zip(stamps, pieces, strict=True)]
    said = "ns" if text else mapping.time_unit or heading
    found = stamps_of(main, said, where, who="the heading", rate=facts.rate)
    notes = _text_notes(text) if text else [found.note] * bool(found.note)
    unit, steps, first = "text" if text else found.unit, found.steps, found.first
    size = TIME_UNITS.get(unit, 1e-9)
    start = (int(first) if text.dated else None) if text else date_of(first, unit, found.epoch)
    clock = TableClock(
        unit=unit,
        origin=0 if start is None else first,
        start_ns=facts.start_ns if start is None or (text and text.ambiguous) else start,
        rate=1.0 / (steps.step * size),
        threshold=steps.threshold * size,
        text=text,
    )
    clock = _coarse(clock, [seconds_of(s, clock.origin, unit, MISSING) for s in stamps], notes)
    stated = None if mapping.time or mapping.time_unit else facts.rate
    if stated and contradicts(clock.rate, stated):
        raise UnreadableInput(
            f"the lines above the table state {stated:g} Hz, the time stamps in {clock.unit} "
            f"advance with {clock.rate:.4g} Hz",
            where=where,
            remedy=f"--rate {stated:g} takes the former, --time-unit {clock.unit} the latter",
        )
    return clock, notes


def _text_of(
    selection: Selection, mapping: FieldMapping, texts: Sequence[bytes], where: str
) -> TextTime:
    """What stamps as text are made of: parts in columns of their own have a known order."""
    if selection.time_order:
        fraction = "f" * any(b"." in s.split()[-1] for s in texts if s)
        order = selection.time_order
        return TextTime(order if order[-1] in "iu" else order + fraction, True)
    return text_layout(list(texts), mapping.time_format, where)


def _understood(rows: ParsedRows, text: TextTime | None, where: str) -> NDArray[np.generic]:
    """Stamps as numbers; those of bad rows, which are named when they are read, are blank here."""
    numbers, wrong = _numbers(rows.stamps, text)
    if 2 * np.count_nonzero(wrong) > wrong.size:
        raise bad_stamp(replace(rows, lines=None), int(np.argmax(wrong)), 0, where)
    return numbers


def bad_stamp(rows: ParsedRows, index: int, line: int, where: str) -> UnreadableInput:
    """The error for a text stamp that is not understood; `line` is the first row's line, or 0."""
    stamp = bytes(rows.stamps[index]).decode(errors="replace")
    line = int(rows.lines[index]) if rows.lines is not None else line and line + index
    return UnreadableInput(
        f"the time stamp '{stamp[:40]}' is not understood",
        where=f"{where}: line {line}" if line else where,
        remedy="correct or delete that line, or give --time-format",
    )


def _known(stamps: NDArray[np.generic]) -> Flags:
    if stamps.dtype.kind == "i":
        return np.asarray(stamps != MISSING)
    return np.isfinite(stamps.astype(np.float64))


def _text_notes(text: TextTime) -> list[str]:
    if not text.dated:
        what = "midnight" if text.period > 3600.0 else "the end of an hour"
        return [f"time: stamps have no date, {what} is bridged"]
    notes = [] if text.zone else ["time: stamps have no zone, taken as UTC"]
    if text.ambiguous:
        notes.append("time: day and month cannot be told apart, no start date is kept")
    return notes


def _coarse(clock: TableClock, looks: Sequence[Array], notes: list[str]) -> TableClock:
    """The clock with rows spread over their stamp, when most rows share one with the row before."""
    same = np.concatenate([np.diff(t) == 0 for t in looks])
    if same.size == 0 or same.mean() <= 0.5:
        return clock
    counts = [np.diff(np.flatnonzero(np.diff(t) != 0)) for t in looks]
    step, count = 1.0 / clock.rate, np.concatenate(counts)
    typical = float(np.median(count)) if count.size else float(same.sum() + 1)
    notes.append(
        f"time: stamps have a resolution of {step:.6g} s; the rows that share one "
        f"(about {typical:.4g}) are spread evenly over it"
    )
    return replace(
        clock, rate=typical / step, threshold=1.75 * step, resolution=step, typical=typical
    )


def _resolve(table: Table, plans: Sequence[TablePlan], selection: Selection) -> FieldMapping:
    """The mapping that reads this file, and others like it, the same way."""
    dialect, mapping = table.dialect, table.mapping
    signals, clock = [s for plan in plans for s in plan.signals], plans[0].clock
    units = {s.vector.name: s.conversion.source_unit for s in signals}
    # Counts a g that the device was found to have.
    scales = {s.conversion.counts_per_g for s in signals if s.conversion.counts_per_g}
    time = ",".join(map(dialect.address, selection.time)) if len(plans) == 1 else ""
    return resolve_mapping(
        mapping,
        [
            (v, [dialect.address(k) for k in v.parts], units[v.name])
            for v in selection.vectors
            if v.name in units
        ],
        time=time if clock.unit else "",
        rate=None if clock.unit else clock.rate,
        time_unit="" if " since " in selection.time_unit else clock.unit,
        decimal=dialect.decimal,
        delimiter=dialect.delimiter,
        preset=mapping.preset or table.facts.device.name,
        lsb_per_g=mapping.lsb_per_g or (tuple(scales) if len(scales) == 1 else ()),
    )
