"""One pass over a log: the wanted topics' messages as columns, and what is kept of each topic.

Always kept is a topic's survey, the facts that are known only at its end; its samples on demand.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import ImucalError, UnreadableInput, UsageError
from imucalib.readers.messages.decode import Decoder, decoder_for
from imucalib.readers.messages.layout import Groups, LayoutError
from imucalib.readers.messages.records import MessageBlock, MessageLog, Topic
from imucalib.readers.messages.select import TopicFields, fields_of, is_imu, split_address
from imucalib.recording.mapping import FieldMapping


class Samples(NamedTuple):
    """Consecutive samples of one topic, in file order.

    stamps : (n,) in the message's own unit, or None; log : (n,) int64 ns; columns : (n, k) each
    """

    topic: str
    stamps: NDArray[Any] | None
    log: NDArray[np.int64]
    columns: list[NDArray[Any]]


@dataclass
class Source:
    """A topic that is read; `rows` samples so far, `marks` the rows before which damage lies."""

    name: str
    fields: TopicFields
    imu: bool
    rows: int = 0
    bad: int = 0
    problem: str = ""
    marks: list[int] = field(default_factory=list)


class DecodedRows(NamedTuple):
    """Decoded messages of several topics, in file order."""

    channels: NDArray[np.int64]
    log: NDArray[np.int64]
    stamps: NDArray[Any] | None
    columns: list[NDArray[Any]]


@dataclass
class Lane:
    """Topics that decode together: one decoder, the same groups; and what waits for division."""

    decoder: Decoder
    groups: Groups
    widths: tuple[int, ...]
    timed: bool
    waiting: list[DecodedRows] = field(default_factory=list)
    rows: int = 0


def joined_stamps(stamps: NDArray[Any]) -> NDArray[Any]:
    """(n,) stamps: seconds and nanoseconds as int64 ns, a single number as it is."""
    if stamps.shape[1] == 2:
        pair = stamps.astype(np.int64)
        total: NDArray[np.int64] = pair[:, 0] * 1_000_000_000 + pair[:, 1]
        return total
    only = stamps[:, 0]
    return only.astype(np.float64 if only.dtype.kind == "f" else np.int64)


_PIECE = 4096  # rows of one stretch that is kept to judge the norm at rest
_LARGEST_SLAB = 1 << 20  # rows
_HEAD = 1 << 15  # rows that the sampling period is taken from


Stamps = NDArray[Any]  # int64 or float64, as the file has it


class Growing:
    """Rows appended in slabs, which become one array at the end: nothing is copied meanwhile."""

    def __init__(self, width: int | None, dtype: type, expected: int = 0) -> None:
        self._expected = expected
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
        first = self._expected if not self._slabs else 0
        rows = max(rows, first, min(self.size, _LARGEST_SLAB), _PIECE if rows else 0)
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

    def update(
        self, stamps: Stamps | None, log: Stamps, columns: list[Array], *, passing: bool
    ) -> None:
        """Add consecutive samples; the result does not depend on how they are divided.

        passing : whether the columns are given up afterwards, so that what is kept is copied
        """
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
                part = column[a - start : b - start]
                kept.setdefault(number, []).append(part.copy() if passing else part)
        self.rows = stop

    def rest_pieces(self, column: int) -> list[Array]:
        """Stretches of consecutive raw samples from all over the recording."""
        return [np.concatenate(parts) for parts in self.pieces[column].values()]


def _stretches(first: int, last: int) -> list[int]:
    """Stretches 0 to 3 and every power of two: the start in detail, the rest now and then."""
    chosen = [*range(4), *(1 << k for k in range(2, 40))]
    return [number for number in chosen if first <= number <= last]


_BATCH = 4096  # rows that are surveyed at once when samples are not kept


class Store:
    """Samples by topic. With `keep`, whole arrays; without, only what the surveys need.

    expected : topic -> how many samples to make room for, 0 when unknown
    """

    def __init__(self, keep: bool, expected: Callable[[str], int]) -> None:
        self._expected = expected
        self.surveys: dict[str, Survey] = {}
        self._keep = keep
        self._kept: dict[str, _Kept] = {}

    def add(self, samples: Samples) -> None:
        """Add consecutive samples of one topic."""
        kept = self._kept.get(samples.topic)
        if kept is None:
            kept = self._kept[samples.topic] = _Kept(
                samples, self._expected(samples.topic) if self._keep else 0
            )
            self.surveys[samples.topic] = Survey(len(samples.columns))
        kept.append(samples)
        if not self._keep and kept.log.size >= _BATCH:
            self._survey(samples.topic)

    def close(self) -> None:
        """Finish the surveys; with `keep`, the arrays become whole one after the other."""
        for topic, kept in self._kept.items():
            kept.whole()
            self._survey(topic)

    def taken(
        self, topic: str, *, needs_stamps: bool
    ) -> tuple[Stamps | None, NDArray[np.int64], list[Array]]:
        """The kept stamps, log times and columns of a topic, handed over."""
        stamps, log, columns = self._kept.pop(topic).arrays()
        return stamps if needs_stamps else None, log, columns

    def without_stamps(self, topic: str) -> Survey:
        """The survey of a topic as if its messages had no stamp."""
        survey = self.surveys[topic]
        copy = replace(survey, stamp=ClockFacts(), head_stamp=[])
        copy.alive, copy.pieces = survey.alive, survey.pieces
        return copy

    def _survey(self, topic: str) -> None:
        stamps, log, columns = self._kept[topic].arrays()
        if log.size:
            self.surveys[topic].update(stamps, log, columns, passing=not self._keep)


class _Kept:
    """The arrays of one topic, growing until they are whole."""

    def __init__(self, first: Samples, expected: int) -> None:
        self.stamps = None
        if first.stamps is not None:
            self.stamps = Growing(None, first.stamps.dtype.type, expected)
        self.log = Growing(None, np.int64, expected)
        widths = [column.shape[1] for column in first.columns]
        self.columns = [Growing(width, np.float64, expected) for width in widths]
        self._arrays: tuple[Stamps | None, NDArray[np.int64], list[Array]] | None = None

    def append(self, samples: Samples) -> None:
        if self.stamps is not None and samples.stamps is not None:
            self.stamps.append(samples.stamps)
        self.log.append(samples.log)
        for growing, column in zip(self.columns, samples.columns, strict=True):
            growing.append(column)

    def whole(self) -> None:
        """End the growth; `arrays` then gives the same arrays every time."""
        self._arrays = self.arrays()

    def arrays(self) -> tuple[Stamps | None, NDArray[np.int64], list[Array]]:
        """What has grown, taken out."""
        if self._arrays is not None:
            return self._arrays
        stamps = self.stamps.taken() if self.stamps is not None else None
        return stamps, self.log.taken(), [column.taken() for column in self.columns]


_UNDECIDED, _SKIPPED = -1, -2
_FRAME = "header.frame_id"
_GATHER = 1 << 16  # rows that are decoded before they are divided among their topics


class TopicStream:
    """Reads the topics that the mapping wants; `sources`, `counts` and notes fill meanwhile."""

    def __init__(
        self, log: MessageLog, mapping: FieldMapping, *, strict: bool, gather: int = _GATHER
    ) -> None:
        self._gather = min(gather, _GATHER)
        self.path, self.mapping, self.strict = log.path, mapping, strict
        self.scanner = log.scan(strict=strict)
        self.sources: dict[str, Source] = {}
        self.counts: dict[int, int] = {}
        self.orphans = 0
        self._hints, self._counted = log.summary()
        self._imu_known = any(is_imu(topic) for topic in self._hints.values())
        self._lane_of = np.full(1 << 16, _UNDECIDED, dtype=np.int64)
        self._lanes: list[Lane] = []
        self._decoders: dict[tuple[object, ...], Decoder] = {}
        self._source_of: dict[int, Source] = {}
        self._reasons: dict[int, str] = {}
        self._unread: dict[str, int] = {}

    def samples(self) -> Iterator[Samples]:
        """All wanted samples, divided by topic, some chunks at a time."""
        damages = 0
        for block in self.scanner.blocks():
            if len(self.scanner.damages) != damages:
                damages = len(self.scanner.damages)
                yield from self._divide_all()
                for source in self.sources.values():
                    source.marks.append(source.rows)
            channels = block.header("channel").astype(np.int64)
            self._count(block, channels)
            lanes = self._lane_of[channels]
            for number, lane in enumerate(self._lanes):
                wanted = lanes == number
                if wanted.all():
                    self._decode(lane, block, channels)
                elif wanted.any():
                    self._decode(lane, block.take(wanted), channels[wanted])
                if lane.rows >= self._gather:
                    yield from self._divide(lane)
        yield from self._divide_all()

    def topic(self, number: int) -> Topic | None:
        """The topic of a channel number, from the data or else from the file's summary."""
        return self.scanner.topics.get(number) or self._hints.get(number)

    def topics(self) -> list[Topic]:
        """Every topic of the log, once the pass is over."""
        return list({**self._hints, **self.scanner.topics}.values())

    def expected(self, topic: str) -> int:
        """How many messages of a topic the summary counts, at most what the file can hold."""
        numbers = [n for n, known in self._hints.items() if known.name == topic]
        total = sum(self._counted.get(n, 0) for n in numbers)
        return min(total, 100 * self.path.stat().st_size)

    def reasons(self) -> dict[str, str]:
        """Topics that could not be read, with the reason."""
        known = {number: self.topic(number) for number in self._reasons}
        return {topic.name: self._reasons[n] for n, topic in known.items() if topic is not None}

    def losses(self) -> list[str]:
        """Notes on what was damaged or could not be decoded."""
        notes = [f"damaged at {damage}" for damage in self.scanner.damages]
        for source in self.sources.values():
            if source.bad:
                notes.append(
                    f"{source.name}: {source.bad} messages cannot be decoded and are left out"
                    f" ({source.problem})"
                )
        for name, count in self._unread.items():
            notes.append(f"{name}: {count} messages cannot be decoded and are left out")
        if self.orphans:
            notes.append(f"{self.orphans} messages belong to channels that the file never defines")
        return notes

    # -- choosing -----------------------------------------------------------------------------

    def _count(self, block: MessageBlock, channels: NDArray[np.int64]) -> None:
        counts = np.bincount(channels)
        for number in np.flatnonzero(counts).tolist():
            self.counts[number] = self.counts.get(number, 0) + int(counts[number])
            if self._lane_of[number] == _UNDECIDED:
                row = int(np.argmax(channels == number))
                start = int(block.starts[row])
                payload = block.data[start : start + int(block.lengths[row])]
                self._lane_of[number] = self._decide(number, payload, int(counts[number]))

    def _decide(self, number: int, payload: bytes, count: int) -> int:
        topic = self.topic(number)
        if topic is None:
            self.orphans += count
            self._fail("a message belongs to a channel that the file never defines")
            return _UNDECIDED
        imu = is_imu(topic)
        self._imu_known = self._imu_known or imu
        stated = self._is_stated(topic)
        fields: TopicFields | None = None
        if stated or (stated is None and (imu or not self._imu_known)):
            try:
                decoder = self._decoder(topic)
                fields = fields_of(topic, decoder.leaves(payload), self.mapping)
                frame = decoder.text(payload, _FRAME) if fields else ""
            except LayoutError as error:
                return self._refuse(number, topic, str(error), bool(stated or imu), count)
            except UsageError as error:
                if stated or imu:
                    raise
                return self._refuse(number, topic, str(error), False, count)
        if fields is None:
            return _SKIPPED
        return self._assign(number, topic, decoder, replace(fields, frame=frame), count)

    def _assign(
        self, number: int, topic: Topic, decoder: Decoder, fields: TopicFields, count: int
    ) -> int:
        """The lane of a channel that is read."""
        source = self.sources.setdefault(topic.name, Source(topic.name, fields, is_imu(topic)))
        if source.fields.groups != fields.groups:
            return self._refuse(number, topic, "its fields differ within the file", True, count)
        self._source_of[number] = source
        for i, lane in enumerate(self._lanes):
            if lane.decoder is decoder and lane.groups == fields.groups:
                return i
        timed = bool(fields.time_leaves)
        self._lanes.append(Lane(decoder, fields.groups, fields.widths, timed))
        return len(self._lanes) - 1

    def _is_stated(self, topic: Topic) -> bool | None:
        """Whether the mapping names the topic; None when it names no topic at all."""
        texts = [*self.mapping.acc, *self.mapping.gyro, *self.mapping.temperature]
        if not any(texts):
            return None
        return any(split_address(text, topic) is not None for text in texts if text)

    def _decoder(self, topic: Topic) -> Decoder:
        schema = topic.schema[1:] if topic.schema else None
        key = (topic.encoding, schema)
        if key not in self._decoders:
            self._decoders[key] = decoder_for(topic)
        return self._decoders[key]

    def _refuse(self, number: int, topic: Topic, why: str, wanted: bool, count: int) -> int:
        self._reasons[number] = why
        if wanted:
            self._fail(f"topic {topic.name} cannot be decoded: {why}")
            self._unread[topic.name] = self._unread.get(topic.name, 0) + count
        # Its first message may be the damaged one: the next block gets another chance.
        return _UNDECIDED if wanted else _SKIPPED

    def _fail(self, what: str) -> None:
        if self.strict:
            raise UnreadableInput(what, where=str(self.path), remedy="read it without strict")

    # -- decoding -----------------------------------------------------------------------------

    def _decode(self, lane: Lane, block: MessageBlock, channels: NDArray[np.int64]) -> None:
        decoded = lane.decoder.decode(block, lane.groups, lane.widths)
        clock = "publish_time" if self.mapping.time == "publish_time" else "log_time"
        log = block.header(clock).astype(np.int64)
        good, columns, stamps = decoded.good, list(decoded.columns), None
        if lane.timed:
            pair = columns.pop()
            if pair.dtype.kind == "f":
                good = good & np.isfinite(pair).all(axis=1)
            stamps = joined_stamps(np.where(good[:, None], pair, 0) if not good.all() else pair)
        if not good.all():
            self._drop(channels[~good], decoded.problem or "a time stamp is not a number")
            channels, log, columns = channels[good], log[good], [c[good] for c in columns]
            stamps = stamps[good] if stamps is not None else None
        # Copies, so that the block's bytes are free.
        columns = [c.astype(np.float64) for c in columns]
        lane.waiting.append(DecodedRows(channels, log, stamps, columns))
        lane.rows += channels.size

    def _drop(self, channels: NDArray[np.int64], problem: str) -> None:
        for number, count in zip(*np.unique(channels, return_counts=True), strict=True):
            source = self._source_of[int(number)]
            source.bad += int(count)
            source.problem = problem
            self._fail(f"topic {source.name}: {problem}")

    def _divide_all(self) -> Iterator[Samples]:
        for lane in self._lanes:
            yield from self._divide(lane)

    def _divide(self, lane: Lane) -> Iterator[Samples]:
        waiting, lane.waiting, lane.rows = lane.waiting, [], 0
        if not waiting:
            return
        channels = np.concatenate([w.channels for w in waiting])
        log = np.concatenate([w.log for w in waiting])
        stamps = np.concatenate([w.stamps for w in waiting]) if lane.timed else None
        columns = [
            np.concatenate(parts) for parts in zip(*(w.columns for w in waiting), strict=True)
        ]
        for number in np.flatnonzero(np.bincount(channels)).tolist():
            rows = np.flatnonzero(channels == number)
            part: Any = slice(None) if rows.size == channels.size else rows
            source = self._source_of[number]
            source.rows += rows.size
            own = stamps[part] if stamps is not None else None
            yield Samples(source.name, own, log[part], [c[part] for c in columns])


def checked(error: Exception, path: Path) -> ImucalError:
    """A failure of the operating system while reading, in this package's terms."""
    detail = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return UnreadableInput(
        f"the file cannot be read: {detail}", where=str(path), remedy="check the disk or share"
    )
