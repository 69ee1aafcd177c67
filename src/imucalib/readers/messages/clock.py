"""The clock of a topic, and its samples in time order with their gaps.

log_time is the recorder's, the stamp in the message the sensor's. That is used unless it is absent,
constant, or jumps; nothing is resampled. Where a buffer is read and all of its samples get one
stamp, they are spread evenly up to the next stamp.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Index
from imucalib.errors import UnreadableInput
from imucalib.readers.messages.stream import ClockFacts, Stamps, Survey
from imucalib.readers.timebase import SIDES, set_back, stepping
from imucalib.recording.mapping import TIME_UNITS
from imucalib.recording.recording import Gap

TWO_PERIODS = 1.75  # a longer step lacks a sample, even where jitter makes it no gap
SET_BACK = 1_000_000_000  # ns: a stamp further back is a clock that jumped
_YEAR_2000 = 946_684_800 * 10**9


@dataclass(frozen=True)
class Clock:
    """How the times of one topic are found.

    source : "stamp", "log_time" or "rate"
    factor : ns in one unit of the stamp
    late : ns by which a sample may come after a later one
    period, longest : ns; the sampling period and the longest step that is no gap
    first : ns, the earliest time
    notes : what was decided and counted
    batched : whether most samples share their stamp with the one before, and are spread
    """

    source: str
    factor: int
    late: int
    period: float
    longest: float
    first: int
    notes: tuple[str, ...]
    batched: bool = False

    @property
    def dated(self) -> bool:
        return self.first >= _YEAR_2000

    def ns(self, stamps: Stamps | None, log: Stamps, row: int) -> NDArray[np.int64]:
        """int64 ns of consecutive samples, the first of which has the number `row`."""
        if self.source == "rate":
            steps = (row + np.arange(log.size)) * self.period
            times: NDArray[np.int64] = self.first + np.rint(steps).astype(np.int64)
            return times
        if self.source == "log_time" or stamps is None:
            return log
        return to_ns(stamps, self.factor)


def to_ns(stamps: Stamps, factor: int) -> NDArray[np.int64]:
    """Stamps in units of `factor` ns as int64 ns."""
    if stamps.dtype.kind == "f":
        return np.rint(stamps * float(factor)).astype(np.int64)
    whole: NDArray[np.int64] = stamps.astype(np.int64, copy=False)
    return whole if factor == 1 else whole * np.int64(factor)


def batches(times: NDArray[np.int64]) -> Index:
    """Where a sample has another stamp than the one before."""
    return np.flatnonzero(np.diff(times, prepend=times[:1] - 1))


def spread(times: NDArray[np.int64], period: float) -> NDArray[np.int64]:
    """Samples that share a stamp (ns), evenly up to the next stamp; by the period where that is
    further (samples are missing) or where there is none."""
    starts = batches(times)
    counts = np.diff(starts, append=times.size)
    step = np.append(np.diff(times[starts]) / counts[:-1], period) if starts.size else np.empty(0)
    step = np.where(step > TWO_PERIODS * period, period, step)
    rank = np.arange(times.size) - np.repeat(starts, counts)
    moved: NDArray[np.int64] = times + np.rint(rank * np.repeat(step, counts)).astype(np.int64)
    return moved


def choose_clock(
    survey: Survey,
    *,
    scalar: bool,
    time_unit: str,
    rate: float | None,
    apart: str = "",
    where: str = "",
) -> Clock:
    """Decide between the stamp and log_time.

    scalar : the stamp is one number of unknown unit rather than seconds and nanoseconds
    apart : why no stamp of the log can be used, or empty; where : the topic, for the error
    Raises UnreadableInput where all samples have one time, and no rate is stated.
    """
    log, stamp, notes = survey.log, survey.stamp, []
    factor, why = 1, ""
    if stamp.count and scalar:
        factor, why = _unit(stamp, log, time_unit)
    why = apart or _useless(stamp, log, factor) or why
    if rate:
        chosen, head, facts, factor = "rate", survey.head_log, log, 1
        notes.append(f"time from the stated rate of {rate:g} Hz")
    elif why:
        chosen, head, facts, factor = "log_time", survey.head_log, log, 1
        notes.append(f"time from log_time: {why}")
    else:
        chosen, head, facts = "stamp", survey.head_stamp, stamp
    times = to_ns(np.concatenate(head), factor)
    batched = 2 * facts.repeats > facts.count and not (facts.backs or rate)
    batched &= batches(times).size > 1
    if facts.backs:
        times = np.sort(times)
    elif batched:
        times = spread(times, _batch_period(times))
        each = facts.count / (facts.count - facts.repeats)
        other = "; --time log_time takes the recorder's clock" * (log.repeats < facts.repeats)
        notes.append(f"about {each:.3g} samples share a stamp, spread evenly up to the next{other}")
    period, longest = _period(times)
    if rate:
        return Clock("rate", 1, 0, 1e9 / rate, np.inf, int(log.first), notes=tuple(notes))
    if facts.count > 1 and facts.low == facts.high:
        raise UnreadableInput(
            f"all {facts.count} samples have one time, by their stamps and by log_time",
            where=where,
            remedy="give the sampling rate with --rate",
        )
    notes += _counted(survey, facts, factor, times, period, batched=batched)
    late, first = int(np.ceil(facts.late * factor)), int(to_ns(np.array([facts.low]), factor)[0])
    return Clock(
        source=chosen,
        factor=factor,
        late=late,
        period=period,
        longest=longest,
        first=first,
        notes=tuple(notes),
        batched=batched,
    )


def _useless(stamp: ClockFacts, log: ClockFacts, factor: int) -> str:
    """Why a topic's stamps are no clock, or empty."""
    if not stamp.count:
        return "no stamp in the messages"
    if stamp.zeros == stamp.count:
        return "the stamp is always zero"
    if stamp.low == stamp.high and stamp.count > 1:
        return "the stamp never changes"
    if factor and stamp.late * factor > max(SET_BACK, int(log.late)):
        return f"the stamp jumps back by up to {float(stamp.late) * factor * 1e-9:.6g} s"
    return ""


def _batch_period(times: NDArray[np.int64]) -> float:
    """ns between samples that come in batches."""
    starts = batches(times)
    return float(np.median(np.diff(times[starts]) / np.diff(starts)))


def _unit(stamp: ClockFacts, log: ClockFacts, time_unit: str) -> tuple[int, str]:
    """ns in one unit of a stamp, from what is stated or from the pace of log_time."""
    if time_unit in TIME_UNITS:
        return round(TIME_UNITS[time_unit] * 1e9), ""
    span = float(stamp.last) - float(stamp.first)
    ratio = (float(log.last) - float(log.first)) / span if span > 0 else 0.0
    for factor in (1, 1000, 1_000_000, 1_000_000_000):
        if factor / 2 < ratio < factor * 2:
            return factor, ""
    return 0, "the unit of its stamp is not clear from its pace; name it with time_unit"


def _period(times: NDArray[np.int64]) -> tuple[float, float]:
    if times.size < 2:
        return 0.0, np.inf
    found = stepping([(times - times[0]) * 1e-9])
    if found is None:
        return 0.0, np.inf
    steps = np.diff(times)
    return float(np.median(steps[steps > 0])), found.threshold * 1e9


def _counted(
    survey: Survey,
    facts: ClockFacts,
    factor: int,
    times: NDArray[np.int64],
    period: float,
    *,
    batched: bool,
) -> list[str]:
    notes = []
    if facts.count > 1:
        own = _pace(facts, factor)
        spread = np.quantile(np.abs(np.diff(times) - period), 0.99) * 1e-3
        stamped = f"{own:.6g} Hz by its stamps, " if facts is survey.stamp else ""
        notes.append(
            f"{facts.count} samples, {stamped}{_pace(survey.log, 1):.6g} Hz"
            f" by log_time; 99 % of the steps within {spread:.3g} us of {period * 1e-3:.6g} us"
        )
    if facts.repeats and not batched:
        notes.append(f"{facts.repeats} times are equal to the one before")
    if facts.backs:
        late = float(facts.late) * factor * 1e-9
        notes.append(f"{facts.backs} steps back in time, by up to {late:.3g} s, put in order")
    return notes


def _pace(facts: ClockFacts, factor: int) -> float:
    span = float(facts.high - facts.low) * factor * 1e-9
    return (facts.count - 1) / span if span > 0 else 0.0


_MOST_PARTS = 100


@dataclass
class Timeline:
    """Turns the samples of a topic, in file order, into samples in time order with gaps."""

    clock: Clock
    start_ns: int
    label: str
    missing: int = 0
    _row: int = 0
    _sent: int = 0
    _last: int | None = None
    _tail: NDArray[np.int64] | None = None
    _held: tuple[NDArray[np.int64], list[Array]] | None = None

    def push(
        self, stamps: Stamps | None, log: Stamps, columns: list[Array], marks: list[int]
    ) -> tuple[Array, list[Array], list[Gap]]:
        """Times (s), values and gaps that are final after these samples.

        marks : row numbers before which a part of the file is damaged
        """
        ns = self.clock.ns(stamps, log, self._row)
        self._row += log.size
        if self.clock.batched and ns.size:
            return self._finished(*self._spread(ns, columns), marks)
        if not self.clock.late or not ns.size:
            return self._finished(ns, columns, marks)
        done, first = list[tuple[Array, list[Array], list[Gap]]](), 0
        for row in [*self._set_back(ns), ns.size]:
            part = self._ordered(ns[first:row], [c[first:row] for c in columns])
            done.append(self._finished(*part, marks))
            rest = self.flush(marks) if row < ns.size else None
            done += [rest] if rest else []
            first = row
        t = np.concatenate([d[0] for d in done])
        joined = [np.concatenate(c) for c in zip(*(d[1] for d in done), strict=True)]
        return t, joined, [g for d in done for g in d[2]]

    def _set_back(self, ns: NDArray[np.int64]) -> list[int]:
        """Rows where the clock was set back; a message that comes late sets no clock."""
        before = self._tail if self._tail is not None else ns[:0]
        rows = set_back(ns, before, SET_BACK)
        start = rows[-1] if rows else 0
        self._tail = (ns[start:] if rows else np.concatenate([before, ns]))[-SIDES:]
        return rows if len(rows) <= _MOST_PARTS else []

    def flush(self, marks: list[int]) -> tuple[Array, list[Array], list[Gap]] | None:
        """The samples that were held back for their order, or for the next stamp."""
        held, self._held = self._held, None
        if held and self.clock.batched:
            held = spread(held[0], self.clock.period), held[1]
        return self._finished(*held, marks) if held else None

    def _spread(
        self, ns: NDArray[np.int64], columns: list[Array]
    ) -> tuple[NDArray[np.int64], list[Array]]:
        """Batches of one stamp, spread; the last waits for the stamp after it."""
        if self._held:
            ns = np.concatenate([self._held[0], ns])
            columns = [np.concatenate(p) for p in zip(self._held[1], columns, strict=True)]
        cut = int(batches(ns)[-1])
        self._held = (ns[cut:], [c[cut:] for c in columns])
        return spread(ns, self.clock.period)[:cut], [c[:cut] for c in columns]

    def _ordered(
        self, ns: NDArray[np.int64], columns: list[Array]
    ) -> tuple[NDArray[np.int64], list[Array]]:
        if self._held:
            ns = np.concatenate([self._held[0], ns])
            columns = [np.concatenate(p) for p in zip(self._held[1], columns, strict=True)]
        order = np.argsort(ns, kind="stable")
        ns, columns = ns[order], [c[order] for c in columns]
        cut = int(np.searchsorted(ns, ns[-1] - self.clock.late, side="right"))
        self._held = (ns[cut:], [c[cut:] for c in columns])
        return ns[:cut], [c[:cut] for c in columns]

    def _finished(
        self, ns: NDArray[np.int64], columns: list[Array], marks: list[int]
    ) -> tuple[Array, list[Array], list[Gap]]:
        gaps: list[Gap] = []
        if ns.size:
            gaps = self._gaps(ns, marks)
            self._sent += ns.size
            self._last = int(ns[-1])
        t = (ns - self.start_ns).astype(np.float64)
        t *= 1e-9
        return t, columns, gaps

    def _gaps(self, ns: NDArray[np.int64], marks: list[int]) -> list[Gap]:
        steps = np.diff(ns, prepend=ns[0] if self._last is None else self._last)
        period = self.clock.period
        far = steps > TWO_PERIODS * period if period else np.zeros(ns.size, dtype=np.bool_)
        broken = np.zeros(ns.size, dtype=np.bool_)
        inside = [m - self._sent for m in marks if self._sent <= m < self._sent + ns.size]
        broken[inside] = True
        long = steps > self.clock.longest
        self.missing += int(np.rint(steps[far & ~long] / period - 1).sum()) if far.any() else 0
        gaps = []
        back = steps < -SET_BACK
        for i in np.flatnonzero((far & broken) | long | back).tolist():
            stop = int(ns[i])
            reason = "a damaged part of the file" if broken[i] else "no samples"
            reason = "time steps back" if back[i] else reason
            edges = [(t - self.start_ns) * 1e-9 for t in (stop - int(steps[i]), stop)]
            gaps.append(Gap(edges[0], edges[1], f"{self.label}: {reason}"))
        return gaps
