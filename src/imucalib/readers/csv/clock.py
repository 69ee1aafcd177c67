"""The clock of a text table: from its stamps, or from a rate and the row number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers.csv import time as csv_time
from imucalib.readers.csv.header import HeaderFacts
from imucalib.readers.csv.parse import Layout, Rows
from imucalib.readers.csv.select import Selection
from imucalib.readers.csv.time import MISSING, TextTime
from imucalib.readers.timebase import Stepping, guess_unit, is_absolute, stepping
from imucalib.recording.mapping import TIME_UNITS, FieldMapping

_DAY = 86_400.0


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

    def seconds(self, stamps: np.ndarray[tuple[int, ...], np.dtype[np.generic]]) -> Array:
        """Seconds since the start of parsed stamps (n,); NaN where blank."""
        return _seconds(stamps, self.kind, self.unit, self.origin, self.text)


def _seconds(
    stamps: np.ndarray[tuple[int, ...], np.dtype[np.generic]],
    kind: str, unit: str, origin: float | int, text: TextTime | None,
) -> Array:  # fmt: skip
    if kind == "text" and text is not None:
        stamps = csv_time.text_to_ns(stamps.astype(np.bytes_), text)
    size = TIME_UNITS.get(unit, 1e-9)
    if stamps.dtype.kind != "i":
        return np.asarray((stamps.astype(np.float64) - origin) * size)
    whole = stamps.astype(np.int64)
    seconds: Array = (whole - int(origin)) / round(1.0 / size)
    seconds[whole == MISSING] = np.nan
    return seconds


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
    text = (
        csv_time.text_layout(list(known.texts), mapping.time_format, where)
        if kind == "text"
        else None
    )
    unit = "text" if text else mapping.time_unit or selection.time_unit
    raw = [_numbers(rows.stamps, text, where) for rows in known.rows]
    main = [_numbers(rows.stamps, text, where) for rows in known.main]
    first = next((s[k][0] for s in raw for k in [_known(s)] if k.any()), None)
    if first is None:
        raise UnreadableInput("the time column holds no stamps", where=where, remedy="give --rate")
    raw_steps = stepping([_seconds(s, "int" if text else kind, "s", first, None) for s in main])
    if raw_steps is None:
        raise UnreadableInput("the time stamps never advance", where=where, remedy="give --rate")
    if not text and unit not in TIME_UNITS:
        unit, note = guess_unit(float(first), raw_steps.step, where)
        notes.append(note)
    size = TIME_UNITS.get(unit, 1e-9)
    dated = text.dated if text else is_absolute(float(first) * size)
    origin = first if dated else 0
    start = int(
        round(first * size * 1e9) if isinstance(first, float) else first * round(size * 1e9)
    )
    start_ns = start if dated and not (text and text.ambiguous) else facts.start_ns
    if text:
        notes += _text_notes(text)
    looks = tuple(_seconds(s, "int" if text else kind, unit, origin, None) for s in raw)
    steps = Stepping(raw_steps.step * size, raw_steps.threshold * size)
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
    return coarse, notes


def _numbers(
    stamps: np.ndarray[tuple[int, ...], np.dtype[np.generic]], text: TextTime | None, where: str
) -> np.ndarray[tuple[int, ...], np.dtype[np.generic]]:
    if text is None:
        return stamps
    texts, bad = stamps.astype(np.bytes_), 0
    while True:
        try:
            return csv_time.text_to_ns(texts, text)
        except ValueError as error:  # of a bad row, which is reported when it is read
            bad += 1
            if 2 * bad > texts.size or not isinstance(error.args[0], int):
                raise bad_stamp(Rows(stamps, np.empty((0, 0))), error, 0, where) from error
            texts[error.args[0]] = b""


def bad_stamp(rows: Rows, error: ValueError, line: int, where: str) -> UnreadableInput:
    """The error for a text stamp that does not parse; `line` is the first row's line, or 0."""
    index = int(error.args[0]) if error.args and isinstance(error.args[0], int) else 0
    stamp = bytes(rows.stamps[index]).decode(errors="replace")
    line = int(rows.lines[index]) if rows.lines is not None else line and line + index
    return UnreadableInput(
        f"the time stamp '{stamp[:40]}' is not understood",
        where=f"{where}: line {line}" if line else where,
        remedy="correct or delete that line, or give --time-format",
    )


def _known(stamps: np.ndarray[tuple[int, ...], np.dtype[np.generic]]) -> np.ndarray[
    tuple[int, ...], np.dtype[np.bool_]
]:  # fmt: skip
    return stamps != MISSING if stamps.dtype.kind == "i" else np.isfinite(stamps.astype(np.float64))


def _text_notes(text: TextTime) -> list[str]:
    if not text.dated:
        return ["time: stamps have no date, midnight is bridged"]
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
