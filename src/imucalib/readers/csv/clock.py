"""The clock of a text table: from stamps to seconds since the start, by what the looks hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Flags
from imucalib.errors import UnreadableInput
from imucalib.readers.csv.rows import ParsedRows
from imucalib.readers.csv.select import Selection, Table
from imucalib.readers.csv.stamps import MISSING, TextTime, text_layout, text_to_ns
from imucalib.readers.fields.timebase import contradicts, date_of, seconds_of, stamps_of
from imucalib.recording.mapping import TIME_UNITS, FieldMapping

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
