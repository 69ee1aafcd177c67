"""The clock of a text table: from its stamps, or from a rate and the row number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers.csv import time as csv_time
from imucalib.readers.csv.header import HeaderFacts
from imucalib.readers.csv.parse import Layout, Rows
from imucalib.readers.csv.select import Selection
from imucalib.readers.csv.time import MISSING, TextTime
from imucalib.readers.timebase import (
    Stepping,
    clock_unit,
    contradicts,
    date_of,
    guess_unit,
    seconds_of,
    stepping,
)
from imucalib.recording.mapping import TIME_UNITS, FieldMapping

#: What headings of stamps have in brackets that is no unit.
_NO_UNIT = {"unix", "epoch", "posix", "utc", "gmt", "local", "iso", "iso8601", "iso 8601", "cal",
            "raw", "time", "unix time", "posix time", "unix epoch"}  # fmt: skip


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
            stamps, wrong = csv_time.text_to_ns(stamps.astype(np.bytes_), self.text)
        return seconds_of(stamps, self.origin, self.unit, MISSING), wrong


def clock_of(
    selection: Selection, layout: Layout, mapping: FieldMapping, facts: HeaderFacts,
    *, known: Stamps, where: str,
) -> tuple[Clock, list[str]]:  # fmt: skip
    """The clock, and what had to be found out about it. Raises UnreadableInput without a rate."""
    if not layout.time_kind:
        return _by_rate(mapping.rate or facts.rate, facts, known.rows, where)
    return _by_stamps(selection, layout, mapping, facts, known=known, where=where)


def _by_rate(
    rate: float | None, facts: HeaderFacts, parsed: Sequence[Rows], where: str
) -> tuple[Clock, list[str]]:
    if not rate:
        raise UnreadableInput(
            "the file has neither time stamps nor a sample rate", where=where,
            remedy="give --rate, or --time",
        )  # fmt: skip
    looks = tuple(np.arange(rows.values.shape[0]) / rate for rows in parsed)
    clock = Clock("", "", 0, facts.start_ns, rate, 1.75 / rate, looks=looks)
    return clock, [f"time: row number at {rate:.6g} Hz"]


def _by_stamps(
    selection: Selection, layout: Layout, mapping: FieldMapping, facts: HeaderFacts,
    *, known: Stamps, where: str,
) -> tuple[Clock, list[str]]:  # fmt: skip
    kind, notes = layout.time_kind, []
    text = _text_of(selection, mapping, known, where) if kind == "text" else None
    stated = mapping.time_unit or ("" if selection.time_unit.lower() in _NO_UNIT else
                                   selection.time_unit)  # fmt: skip
    unit, epoch = ("text", None) if text else clock_unit(stated, where)
    raw = [_numbers(rows.stamps, text, where) for rows in known.rows]
    main = [_numbers(rows.stamps, text, where) for rows in known.main]
    first = next((s[k][0].item() for s in raw for k in [_known(s)] if k.any()), None)
    if first is None:
        raise UnreadableInput("the time column holds no stamps", where=where, remedy="give --rate")
    steps = stepping([seconds_of(s, first, "s", MISSING) for s in main])
    if steps is None:
        raise UnreadableInput("the time stamps never advance", where=where, remedy="give --rate")
    if not text and unit not in TIME_UNITS:
        guessed, note = guess_unit(float(first), steps.step, where, facts.rate)
        if unit and date_of(first, guessed) is None:
            raise UnreadableInput(
                f"the heading states the unknown unit of time '{unit[:40]}'", where=where,
                remedy=f"name it with --time-unit: {', '.join(TIME_UNITS)}",
            )  # fmt: skip
        unit = guessed
        notes.append(note)
    size = TIME_UNITS.get(unit, 1e-9)
    start = (int(first) if text.dated else None) if text else date_of(first, unit, epoch)
    origin = 0 if start is None else first
    start_ns = facts.start_ns if start is None or (text and text.ambiguous) else start
    if text:
        notes += _text_notes(text)
    looks = tuple(seconds_of(s, origin, unit, MISSING) for s in raw)
    steps = Stepping(steps.step * size, steps.threshold * size)
    clock = Clock(
        kind=kind, unit=unit, origin=origin, start_ns=start_ns, rate=1.0 / steps.step,
        threshold=steps.threshold, text=text, looks=looks,
    )  # fmt: skip
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
            f"{coarse.unit} advance with {coarse.rate:.4g} Hz", where=where,
            remedy=f"--rate {facts.rate:g} takes the former, --time-unit {coarse.unit} the latter",
        )  # fmt: skip
    return coarse, notes


def _text_of(selection: Selection, mapping: FieldMapping, known: Stamps, where: str) -> TextTime:
    """What stamps as text are made of: parts in columns of their own have a known order."""
    if selection.time_order:
        fraction = "f" * any(b"." in s.split()[-1] for s in known.texts if s)
        order = selection.time_order
        return TextTime(order if order[-1] in "iu" else order + fraction, True)
    return csv_time.text_layout(list(known.texts), mapping.time_format, where)


def _numbers(stamps: NDArray[np.generic], text: TextTime | None, where: str) -> NDArray[Any]:
    """Stamps as numbers; those of bad rows, which are told when they are read, are blank here."""
    if text is None:
        return stamps
    ns, wrong = csv_time.text_to_ns(stamps.astype(np.bytes_), text)
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
