"""The samples of one topic: collected, timed by the better of two clocks, put in order.

log_time is the recorder's clock, the stamp in the message the sensor's. The sensor's is used
unless it is absent, constant, or jumps; nothing is resampled.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.mapping import TIME_UNITS
from imucalib.readers.timebase import stepping
from imucalib.recording import Array, Gap

_PIECE = 4096  # rows of one stretch that is kept to judge the norm at rest
_LARGEST_SLAB = 1 << 20  # rows
_HEAD = 1 << 16  # rows that the sampling period is taken from
_TWO_PERIODS = 1.75  # a longer step lacks a sample, even where jitter makes it no gap
_MOST_LATE = 1_000_000_000  # ns: a stamp further back is a clock that jumped
_YEAR_2000 = 946_684_800 * 10**9

Stamps = NDArray[Any]  # int64 or float64, as the file has it


class Growing:
    """Rows appended in slabs, which become one array at the end: nothing is copied meanwhile."""

    def __init__(self, width: int | None, dtype: type) -> None:
        self._shape = () if width is None else (width,)
        self._dtype = dtype
        self._slabs: list[NDArray[Any]] = []
        self._used = 0  # rows in the last slab
        self.size = 0

    def append(self, rows: NDArray[Any]) -> None:
        """Copy rows (n,) or (n, width) to the end."""
        while rows.shape[0]:
            if not self._slabs or self._used == self._slabs[-1].shape[0]:
                self._start(rows.shape[0])
            count = min(rows.shape[0], self._slabs[-1].shape[0] - self._used)
            self._slabs[-1][self._used : self._used + count] = rows[:count]
            self._used += count
            self.size += count
            rows = rows[count:]

    def taken(self) -> NDArray[Any]:
        """All rows as one array, and the slabs given up; appending starts anew."""
        if self._slabs:
            self._slabs[-1] = self._slabs[-1][: self._used]
        else:
            self._start(0)
        whole = self._slabs[0] if len(self._slabs) == 1 else np.concatenate(self._slabs)
        self._slabs, self._used, self.size = [], 0, 0
        return whole

    def _start(self, rows: int) -> None:
        # Memory that is not written yet costs nothing, so a slab may be generous.
        rows = max(rows, min(self.size, _LARGEST_SLAB), _PIECE if rows else 0)
        self._slabs.append(np.empty((rows, *self._shape), dtype=self._dtype))
        self._used = 0


@dataclass
class ClockFacts:
    """What a clock did over all samples, in its own unit."""

    count: int = 0
    first: Any = 0
    last: Any = 0
    low: Any = 0
    high: Any = 0
    zeros: int = 0
    repeats: int = 0
    backs: int = 0
    late: Any = 0  # the furthest that a stamp lies before an earlier one

    def update(self, stamps: Stamps) -> None:
        """Add consecutive stamps."""
        if stamps.size == 0:
            return
        if self.count:
            steps = np.diff(stamps, prepend=self.last)
        else:
            steps = np.diff(stamps)
            self.first = self.low = self.high = stamps[0].item()
        self.count += stamps.size
        self.zeros += int(stamps.size - np.count_nonzero(stamps))
        self.repeats += int(np.count_nonzero(steps == 0))
        backs = int(np.count_nonzero(steps < 0))
        if backs:
            self.backs += backs
            peaks = np.maximum(np.maximum.accumulate(stamps), self.high)
            self.late = max(self.late, (peaks - stamps).max().item())
        self.last = stamps[-1].item()
        self.low = min(self.low, stamps.min().item())
        self.high = max(self.high, stamps.max().item())


@dataclass
class Survey:
    """Facts of one topic that decide how its samples become channels."""

    width: int  # number of value columns (acceleration, ...)
    stamp: ClockFacts = field(default_factory=ClockFacts)
    log: ClockFacts = field(default_factory=ClockFacts)
    alive: list[bool] = field(default_factory=list)
    pieces: list[dict[int, list[Array]]] = field(default_factory=list)
    head_stamp: list[Stamps] = field(default_factory=list)
    head_log: list[Stamps] = field(default_factory=list)
    rows: int = 0

    def __post_init__(self) -> None:
        self.alive = [False] * self.width
        self.pieces = [{} for _ in range(self.width)]

    def update(self, stamps: Stamps | None, log: Stamps, columns: list[Array]) -> None:
        """Add consecutive samples; the result does not depend on how they are divided."""
        start, stop = self.rows, self.rows + log.size
        self.log.update(log)
        if start < _HEAD:
            self.head_log.append(log[: _HEAD - start].copy())
        if stamps is not None:
            self.stamp.update(stamps)
            if start < _HEAD:
                self.head_stamp.append(stamps[: _HEAD - start].copy())
        for i, column in enumerate(columns):
            self.alive[i] = self.alive[i] or bool(column.any())
        for number in _stretches(start // _PIECE, (stop - 1) // _PIECE):
            a, b = max(number * _PIECE, start), min((number + 1) * _PIECE, stop)
            for kept, column in zip(self.pieces, columns, strict=True):
                kept.setdefault(number, []).append(column[a - start : b - start].copy())
        self.rows = stop

    def rest_pieces(self, column: int) -> list[Array]:
        """Stretches of consecutive raw samples from all over the recording."""
        return [np.concatenate(parts) for parts in self.pieces[column].values()]


def _stretches(first: int, last: int) -> list[int]:
    """Stretches 0 to 3 and every power of two: the start in detail, the rest now and then."""
    chosen = [*range(4), *(1 << k for k in range(2, 40))]
    return [number for number in chosen if first <= number <= last]


@dataclass(frozen=True)
class Clock:
    """How the times of one topic are found.

    source : "stamp", "log_time" or "rate"
    factor : ns in one unit of the stamp
    late : ns by which a sample may come after a later one
    period, longest : ns; the sampling period and the longest step that is no gap
    first : ns, the earliest time
    notes : what was decided and counted
    """

    source: str
    factor: int
    late: int
    period: float
    longest: float
    first: int
    notes: tuple[str, ...]

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


def choose_clock(survey: Survey, *, scalar: bool, time_unit: str, rate: float | None) -> Clock:
    """Decide between the stamp and log_time.

    scalar : the stamp is one number of unknown unit rather than seconds and nanoseconds
    """
    log, stamp, notes = survey.log, survey.stamp, []
    factor, why = 1, ""
    if stamp.count and scalar:
        factor, why = _unit(stamp, log, time_unit)
    if not stamp.count:
        why = "no stamp in the messages"
    elif stamp.zeros == stamp.count:
        why = "the stamp is always zero"
    elif stamp.low == stamp.high and stamp.count > 1:
        why = "the stamp never changes"
    elif factor and stamp.late * factor > max(_MOST_LATE, int(log.late)):
        late = float(stamp.late) * factor * 1e-9
        why = f"the stamp jumps back by up to {late:.6g} s"
    if rate:
        chosen, head, facts, factor = "rate", survey.head_log, log, 1
        notes.append(f"time from the stated rate of {rate:g} Hz")
    elif why:
        chosen, head, facts, factor = "log_time", survey.head_log, log, 1
        notes.append(f"time from log_time: {why}")
    else:
        chosen, head, facts = "stamp", survey.head_stamp, stamp
    times = to_ns(np.concatenate(head), factor)
    if facts.backs:
        times = np.sort(times)
    period, longest = _period(times)
    if rate:
        return Clock("rate", 1, 0, 1e9 / rate, np.inf, int(log.first), tuple(notes))
    notes += _counted(survey, facts, factor, times, period)
    late, first = int(np.ceil(facts.late * factor)), int(to_ns(np.array([facts.low]), factor)[0])
    return Clock(chosen, factor, late, period, longest, first, tuple(notes))


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
    survey: Survey, facts: ClockFacts, factor: int, times: NDArray[np.int64], period: float
) -> list[str]:
    notes = []
    if facts.count > 1:
        own = _pace(facts, factor)
        spread = np.quantile(np.abs(np.diff(times) - period), 0.99) * 1e-3
        notes.append(
            f"{facts.count} samples, {own:.6g} Hz by its stamps, {_pace(survey.log, 1):.6g} Hz"
            f" by log_time; 99 % of the steps within {spread:.3g} us of {period * 1e-3:.6g} us"
        )
    if facts.repeats:
        notes.append(f"{facts.repeats} times are equal to the one before")
    if facts.backs:
        late = float(facts.late) * factor * 1e-9
        notes.append(f"{facts.backs} steps back in time, by up to {late:.3g} s, put in order")
    return notes


def _pace(facts: ClockFacts, factor: int) -> float:
    span = float(facts.high - facts.low) * factor * 1e-9
    return (facts.count - 1) / span if span > 0 else 0.0


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
    _peak: int | None = None
    _held: tuple[NDArray[np.int64], list[Array]] | None = None

    def push(
        self, stamps: Stamps | None, log: Stamps, columns: list[Array], marks: list[int]
    ) -> tuple[Array, list[Array], list[Gap]]:
        """Times (s), values and gaps that are final after these samples.

        marks : row numbers before which a part of the file is damaged
        """
        ns = self.clock.ns(stamps, log, self._row)
        self._row += log.size
        if self.clock.late and ns.size:
            ns, columns = self._ordered(ns, columns)
        return self._finished(ns, columns, marks)

    def flush(self, marks: list[int]) -> tuple[Array, list[Array], list[Gap]] | None:
        """The samples that were held back for their order."""
        held, self._held = self._held, None
        return self._finished(*held, marks) if held else None

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
        far = steps > _TWO_PERIODS * period if period else np.zeros(ns.size, dtype=np.bool_)
        broken = np.zeros(ns.size, dtype=np.bool_)
        inside = [m - self._sent for m in marks if self._sent <= m < self._sent + ns.size]
        broken[inside] = True
        long = steps > self.clock.longest
        self.missing += int(np.rint(steps[far & ~long] / period - 1).sum()) if far.any() else 0
        gaps = []
        for i in np.flatnonzero((far & broken) | long).tolist():
            stop = int(ns[i])
            reason = "a damaged part of the file" if broken[i] else "no samples"
            edges = [(t - self.start_ns) * 1e-9 for t in (stop - int(steps[i]), stop)]
            gaps.append(Gap(edges[0], edges[1], f"{self.label}: {reason}"))
        return gaps
