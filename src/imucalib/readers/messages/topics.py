"""A topic that is read: its fields, what is known of its samples after a pass, its clock, and its
samples in time order with their gaps.

log_time is the recorder's, the stamp in the message the sensor's. That is used unless it is absent,
constant, or jumps; nothing is resampled. Where a buffer is read and all of its samples get one
stamp, they are spread evenly up to the next stamp.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers.fields.timebase import SIDES, measure_steps, runs_of, set_back
from imucalib.readers.messages.layout import FieldGroup, Groups
from imucalib.recording.mapping import TIME_UNITS, FieldMapping
from imucalib.recording.recording import Gap

_PIECE = 4096  # rows of one stretch that is kept to judge the norm at rest
#: Stretches that are kept: the start in detail, the rest now and then.
_STRETCHES = (0, *range(1, 4), *(1 << k for k in range(2, 40)))
_HEAD = 1 << 15  # rows that give the sampling period
_TWO_PERIODS = 1.75  # a longer step lacks a sample, even where jitter makes it no gap
_SET_BACK = 1_000_000_000  # ns: a stamp further back is a clock that jumped
_MOST_PARTS = 100  # that a clock which is set back makes
_YEAR_2000 = 946_684_800 * 10**9

Stamps = NDArray[Any]  # int64 or float64, as the file has it
Times = NDArray[np.int64]  # ns


@dataclass(frozen=True)
class TopicField:
    """A quantity in a topic's messages.

    quantity : as in Channel
    address : its place as the mapping writes it; group : the numbers that make it
    unit : what the message type states, "" when it does not
    found : whether the names decided, rather than the user
    sensor : its name within messages of several sensors, else ""
    """

    quantity: str
    address: str
    group: FieldGroup
    unit: str = ""
    found: bool = True
    sensor: str = ""


@dataclass
class ClockFacts:
    """What a clock did over all samples, in its own unit; head : its first stamps."""

    count: int = 0
    first: Any = 0
    last: Any = 0
    low: Any = 0
    high: Any = 0
    zeros: int = 0
    repeats: int = 0
    backs: int = 0
    late: Any = 0  # the furthest that a stamp lies before an earlier one
    head: list[Stamps] = field(default_factory=list)

    def update(self, stamps: Stamps) -> None:
        """Add consecutive stamps; how they are divided does not matter."""
        if stamps.size == 0:
            return
        if self.count:
            steps = np.diff(stamps, prepend=self.last)
        else:
            steps = np.diff(stamps)
            self.first = self.low = self.high = stamps[0].item()
        if self.count < _HEAD:
            self.head.append(stamps[: _HEAD - self.count].copy())
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
class TopicSource:
    """A topic that is read, and what its samples were so far.

    fields : what is read of each message; imu : whether the type is that of an IMU
    time : address of its stamp, "" for none; instant : the numbers of that
    frame : the frame_id of its first message, "" for none
    triad, origin_ns, dated : as this package's own files state them, else "", None and True
    rows : samples that were read; bad, problem : messages that could not be, and why the last
    moved : samples that were put in another order than that of the file
    more : samples beyond one a message, where messages hold lists of them
    marks : rows before which a part of the file is damaged
    alive : of each field, whether any value differs from zero
    pieces : stretches of raw samples from all over the recording, by number, each in parts
    """

    name: str
    imu: bool
    fields: tuple[TopicField, ...]
    time: str = ""
    instant: FieldGroup | None = None
    frame: str = ""
    triad: str = ""
    origin_ns: int | None = None
    dated: bool = True
    rows: int = 0
    bad: int = 0
    moved: int = 0
    more: int = 0
    problem: str = ""
    marks: list[int] = field(default_factory=list)
    stamps: ClockFacts = field(default_factory=ClockFacts)
    log: ClockFacts = field(default_factory=ClockFacts)
    alive: list[bool] = field(default_factory=list)
    pieces: dict[int, list[list[Array]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.alive = [False] * len(self.fields)

    @property
    def groups(self) -> Groups:
        """The numbers of every field, and of the stamp as the last group when there is one."""
        last = (self.instant,) if self.instant else ()
        return tuple(f.group for f in self.fields) + last

    def survey(self, samples: TopicSamples) -> None:
        """Note the facts of consecutive samples; how they are divided does not matter."""
        start, stop = self.log.count, self.log.count + samples.log.size
        self.log.update(samples.log)
        if samples.stamps is not None:
            self.stamps.update(samples.stamps)
        for i, column in enumerate(samples.columns):
            self.alive[i] = self.alive[i] or bool(column.any())
        for number in _STRETCHES:
            first, last = number * _PIECE, (number + 1) * _PIECE
            if first < stop and last > start:
                part = slice(max(first - start, 0), last - start)
                kept = [column[part].copy() for column in samples.columns]
                self.pieces.setdefault(number, []).append(kept)

    def rest_pieces(self, column: int) -> list[Array]:
        """Stretches of consecutive raw samples from all over the recording."""
        return [np.concatenate([p[column] for p in parts]) for parts in self.pieces.values()]


class TopicSamples(NamedTuple):
    """Consecutive samples of one topic, in file order.

    stamps : (n,) in the message's own unit, or None; log : (n,) ns; columns : (n, k) each
    """

    source: TopicSource
    stamps: Stamps | None
    log: NDArray[np.int64]
    columns: list[Array]


@dataclass(frozen=True)
class TopicClock:
    """How the times of one topic are found.

    source : "stamp", "log_time" or "rate"
    period : ns
    first : ns, the earliest time
    notes : what was decided and counted
    factor : ns in one unit of the stamp
    late : ns by which a sample may come after a later one
    longest : ns, the longest step that is no gap
    batched : whether most samples share their stamp with the one before, and are spread
    """

    source: str
    period: float
    first: int
    notes: tuple[str, ...]
    factor: int = 1
    late: int = 0
    longest: float = np.inf
    batched: bool = False

    @property
    def dated(self) -> bool:
        return self.first >= _YEAR_2000

    def times(self, samples: TopicSamples, row: int) -> Times:
        """(n,) of consecutive samples, the first of which has the number `row`."""
        if self.source == "rate":
            steps = (row + np.arange(samples.log.size)) * self.period
            return np.asarray(self.first + np.rint(steps).astype(np.int64))
        if self.source == "log_time" or samples.stamps is None:
            return samples.log
        return _to_ns(samples.stamps, self.factor)


def _to_ns(stamps: Stamps, factor: int) -> Times:
    """Stamps in units of `factor` ns as int64 ns."""
    if stamps.dtype.kind == "f":
        return np.rint(stamps * float(factor)).astype(np.int64)
    whole: Times = stamps.astype(np.int64, copy=False)
    return whole if factor == 1 else whole * np.int64(factor)


def _spread(times: Times, period: float) -> Times:
    """Samples that share a stamp, evenly up to the next stamp; by the period where that is further
    (samples are missing) or where there is none."""
    starts, counts, rank = runs_of(times)
    step = np.append(np.diff(times[starts]) / counts[:-1], period) if starts.size else np.empty(0)
    step = np.where(step > _TWO_PERIODS * period, period, step)
    moved: Times = times + np.rint(rank * np.repeat(step, counts)).astype(np.int64)
    return moved


def choose_clock(
    source: TopicSource, mapping: FieldMapping, where: str, apart: str = ""
) -> TopicClock:
    """Decide between the stamp and log_time.

    apart : why no stamp of the log can be used, or empty; where : the topic, for the error
    Raises UnreadableInput where all samples have one time, and no rate is stated.
    """
    log, stamps = source.log, source.stamps
    if mapping.rate:
        said = f"{mapping.rate:g} Hz as stated"
        return TopicClock("rate", 1e9 / mapping.rate, int(log.first), (said,))
    factor, why = 1, ""
    if source.instant and source.instant.width == 1:
        factor, why = _unit(stamps, log, mapping.time_unit)
    why = apart or _useless(stamps, log, factor) or why
    facts, factor = (log, 1) if why else (stamps, factor)
    notes = [why] if why else []
    times = _to_ns(np.concatenate(facts.head), factor)
    batched = 2 * facts.repeats > facts.count and not facts.backs and runs_of(times)[0].size > 1
    if facts.backs:
        times = np.sort(times)
    elif batched:
        starts, *_ = runs_of(times)
        times = _spread(times, float(np.median(np.diff(times[starts]) / np.diff(starts))))
        each = facts.count / (facts.count - facts.repeats)
        other = "; --time log_time takes the recorder's clock" * (log.repeats < facts.repeats)
        notes.append(f"about {each:.3g} samples share a stamp, spread evenly up to the next{other}")
    if facts.count > 1 and facts.low == facts.high:
        raise UnreadableInput(
            f"all {facts.count} samples have one time, by their stamps and by log_time",
            where=where,
            remedy="give the sampling rate with --rate",
        )
    steps = np.diff(times)
    found = measure_steps([(times - times[0]) * 1e-9])
    period = found.step * 1e9 if found else 0.0
    if facts.count > 1:
        jitter = np.quantile(np.abs(steps - period), 0.99) * 1e-3
        stamped = "" if why else f"{_pace(facts, factor):.6g} Hz by its stamps, "
        notes.append(
            f"{facts.count} samples, {stamped}{_pace(log, 1):.6g} Hz"
            f" by log_time; 99 % of the steps within {jitter:.3g} us of {period * 1e-3:.6g} us"
        )
    if facts.repeats and not batched:
        notes.append(f"{facts.repeats} times are equal to the one before")
    if facts.backs:
        late = float(facts.late) * factor * 1e-9
        notes.append(f"{facts.backs} steps back in time, by up to {late:.3g} s, put in order")
    return TopicClock(
        source="log_time" if why else "stamp",
        factor=factor,
        late=int(np.ceil(facts.late * factor)),
        period=period,
        longest=found.threshold * 1e9 if found else np.inf,
        first=int(_to_ns(np.array([facts.low]), factor)[0]),
        notes=tuple(notes),
        batched=batched,
    )


def _useless(stamps: ClockFacts, log: ClockFacts, factor: int) -> str:
    """Why a topic's stamps are no clock, or empty."""
    if not stamps.count:
        return "no stamp in the messages"
    if stamps.zeros == stamps.count:
        return "the stamp is always zero"
    if stamps.low == stamps.high and stamps.count > 1:
        return "the stamp never changes"
    if factor and stamps.late * factor > max(_SET_BACK, int(log.late)):
        return f"the stamp jumps back by up to {float(stamps.late) * factor * 1e-9:.6g} s"
    return ""


def _unit(stamps: ClockFacts, log: ClockFacts, time_unit: str) -> tuple[int, str]:
    """ns in one unit of a stamp, from what is stated or from the pace of log_time; or why not."""
    if time_unit in TIME_UNITS:
        return round(TIME_UNITS[time_unit] * 1e9), ""
    span = float(stamps.last) - float(stamps.first)
    ratio = (float(log.last) - float(log.first)) / span if span > 0 else 0.0
    for factor in (1, 1000, 1_000_000, 1_000_000_000):
        if factor / 2 < ratio < factor * 2:
            return factor, ""
    return 0, "the unit of its stamp is not clear from its pace; name it with time_unit"


def _pace(facts: ClockFacts, factor: int) -> float:
    span = float(facts.high - facts.low) * factor * 1e-9
    return (facts.count - 1) / span if span > 0 else 0.0


@dataclass
class Timeline:
    """Turns the samples of a topic, in file order, into samples in time order with gaps.

    t, columns, gaps : what is final since they were last emptied; missing : samples that lack in
    steps below a gap's length
    """

    clock: TopicClock
    start_ns: int
    label: str
    t: list[Array] = field(default_factory=list)
    columns: list[list[Array]] = field(default_factory=list)
    gaps: list[Gap] = field(default_factory=list)
    missing: int = 0
    _row: int = 0
    _sent: int = 0
    _last: int | None = None
    _marks: list[int] = field(default_factory=list)
    _tail: Times = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    _held: tuple[Times, list[Array]] | None = None

    def push(self, samples: TopicSamples) -> None:
        """Take consecutive samples."""
        self._marks = samples.source.marks
        times, columns = self.clock.times(samples, self._row), samples.columns
        self._row += times.size
        if not times.size or not (self.clock.batched or self.clock.late):
            self._put(times, columns)
            return
        first = 0
        for row in self._set_back(times) if self.clock.late else []:
            self._order(times[first:row], [c[first:row] for c in columns])
            self.finish()
            first = row
        self._order(times[first:], [c[first:] for c in columns])

    def finish(self) -> None:
        """Let go of the samples that were held back for their order, or for the next stamp."""
        held, self._held = self._held, None
        if held:
            times, columns = held
            self._put(_spread(times, self.clock.period) if self.clock.batched else times, columns)

    def _set_back(self, times: Times) -> list[int]:
        """Rows where the clock was set back; a message that comes late sets no clock."""
        rows = set_back(times, self._tail, _SET_BACK)
        self._tail = (times[rows[-1] :] if rows else np.append(self._tail, times))[-SIDES:]
        return rows if len(rows) <= _MOST_PARTS else []

    def _order(self, times: Times, columns: list[Array]) -> None:
        """Put what is final in order, or apart; what may change is held back."""
        if self._held:
            times = np.concatenate([self._held[0], times])
            columns = [np.concatenate(p) for p in zip(self._held[1], columns, strict=True)]
        if self.clock.batched:
            cut = int(runs_of(times)[0][-1])
            final = _spread(times, self.clock.period)[:cut]
        else:
            order = np.argsort(times, kind="stable")
            times, columns = times[order], [c[order] for c in columns]
            cut = int(np.searchsorted(times, times[-1] - self.clock.late, side="right"))
            final = times[:cut]
        self._held = (times[cut:], [c[cut:] for c in columns])
        self._put(final, [c[:cut] for c in columns])

    def _put(self, times: Times, columns: list[Array]) -> None:
        if not times.size:
            return
        self._note_gaps(times)
        self._sent += times.size
        self._last = int(times[-1])
        t = (times - self.start_ns).astype(np.float64)
        t *= 1e-9
        self.t.append(t)
        self.columns.append(columns)

    def _note_gaps(self, times: Times) -> None:
        steps = np.diff(times, prepend=times[0] if self._last is None else self._last)
        period = self.clock.period
        far = steps > _TWO_PERIODS * period if period else np.zeros(times.size, dtype=np.bool_)
        broken = np.zeros(times.size, dtype=np.bool_)
        broken[[m - self._sent for m in self._marks if 0 <= m - self._sent < times.size]] = True
        long, back = steps > self.clock.longest, steps < -_SET_BACK
        self.missing += int(np.rint(steps[far & ~long] / period - 1).sum()) if far.any() else 0
        for i in np.flatnonzero((far & broken) | long | back).tolist():
            reason = "a damaged part of the file" if broken[i] else "no samples"
            reason = "time steps back" if back[i] else reason
            edges = [
                (t - self.start_ns) * 1e-9 for t in (int(times[i]) - int(steps[i]), int(times[i]))
            ]
            self.gaps.append(Gap(edges[0], edges[1], f"{self.label}: {reason}"))
