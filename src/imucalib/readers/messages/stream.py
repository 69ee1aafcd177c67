"""One pass over a log: the wanted topics' messages as columns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput, UsageError
from imucalib.readers.fields.contents import Content, describe_unread
from imucalib.readers.messages.decode import Decoder, decoder_for
from imucalib.readers.messages.layout import Groups, LayoutError
from imucalib.readers.messages.records import MessageBlock, MessageLog, Topic
from imucalib.readers.messages.select import (
    addresses,
    is_imu,
    is_stated,
    list_left,
    natural_key,
    source_of,
    split_address,
)
from imucalib.readers.messages.topics import Stamps, TopicSamples, TopicSource
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Count

#: Rows that are decoded before they are divided among their topics.
GATHER = 1 << 16
_UNDECIDED, _SKIPPED = -1, -2


class _Rows(NamedTuple):
    """Decoded messages of several topics, in file order."""

    channels: NDArray[np.int64]
    stamps: Stamps | None
    log: NDArray[np.int64]
    columns: list[Array]


@dataclass
class _Lane:
    """Topics that decode together: one decoder, the same groups; and what waits for division."""

    decoder: Decoder
    groups: Groups
    timed: bool
    waiting: list[_Rows] = field(default_factory=list)
    rows: int = 0


class TopicStream:
    """Reads the topics that the mapping wants; `sources`, `counts` and losses fill meanwhile.

    apart : channels whose topic has others at the same time: each is a topic of its own, "/imu#2"
    gather : rows that are decoded before they are divided among their topics
    """

    def __init__(
        self,
        log: MessageLog,
        mapping: FieldMapping,
        apart: frozenset[int] = frozenset(),
        gather: int = GATHER,
    ) -> None:
        self.log, self.mapping, self.apart, self._gather = log, mapping, apart, gather
        self.sources: dict[str, TopicSource] = {}
        self.counts: dict[int, int] = {}
        self.reasons: dict[str, str] = {}  # topics that could not be read, and why
        self._indexed = log.indexed_topics()
        self._imus = {topic.name for topic in self._indexed.values() if is_imu(topic)}
        self._any_stated = is_stated(mapping)
        self._lane_of = np.full(1 << 16, _UNDECIDED, dtype=np.int64)
        self._lanes: list[_Lane] = []
        self._decoders: dict[tuple[object, ...], Decoder] = {}
        self._source_of: dict[int, TopicSource] = {}
        self._undecoded: dict[str, int] = {}
        self._orphans = 0
        self._left: dict[int, list[Content]] = {}
        self._spans: dict[int, tuple[int, int]] = {}  # log times of each channel

    @property
    def topics(self) -> dict[int, Topic]:
        """Topics of the pass so far and of the log's index, by channel number."""
        return {n: self._named(t) for n, t in {**self._indexed, **self.log.topics}.items()}

    def _named(self, topic: Topic) -> Topic:
        """A channel that is apart, or that the mapping names so, with the name of its own."""
        own = f"{topic.name}#{topic.id}"
        texts = addresses(self.mapping)
        if topic.id in self.apart or any(
            split_address(t, replace(topic, name=own)) is not None for t in texts
        ):
            return replace(topic, name=own)
        return topic

    def overlapping(self) -> frozenset[int]:
        """Channels of one topic that were logged at the same time: of several publishers."""
        found = set[int]()
        for one, (low, high) in self._spans.items():
            for other, (first, last) in self._spans.items():
                same = one != other and self._source_of[one] is self._source_of[other]
                if same and low < last and first < high:
                    found.add(one)
        return frozenset(found)

    def samples(self) -> Iterator[TopicSamples]:
        """All wanted samples, divided by topic, some chunks at a time."""
        damages = 0
        for block in self.log.blocks():
            if len(self.log.damages) != damages:
                damages = len(self.log.damages)
                yield from self._divide_all()
                for source in self.sources.values():
                    source.marks.append(source.rows)
            channels = block.header("channel")
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

    def losses(self) -> list[str]:
        """Notes on what was damaged or could not be decoded."""
        words = "messages cannot be decoded and are left out"
        notes = [f"damaged at {damage}" for damage in self.log.damages]
        for source in self.sources.values():
            if source.bad:
                notes.append(f"{source.name}: {source.bad} {words} ({source.problem})")
            if source.moved:
                said = (
                    "messages are stored out of order: put in that of log_time, and of their stamps"
                )
                notes.append(f"{source.name}: {source.moved} {said}")
        for name, count in self._undecoded.items():
            notes.append(f"{name}: {count} {words} ({self.reasons[name]})")
        if self._orphans:
            notes.append(f"{self._orphans} messages belong to channels that the file never defines")
        return notes

    def tallies(self) -> tuple[Count, ...]:
        """What became of the messages of the topics that are read."""
        found = []
        for name, source in self.sources.items():
            numbers = [n for n, topic in self.topics.items() if topic.name == name]
            held = sum(self.counts.get(n, 0) for n in numbers) + source.more
            left = {"cannot be decoded": source.bad + self._undecoded.get(name, 0)}
            found.append(Count(f"messages of {name}", held, source.rows, left))
        return tuple(found)

    def describe_unread(self) -> tuple[str, ...]:
        """The sentence on topics and fields beside those that are read."""
        left = list[Content]()
        for number, topic in sorted(self.topics.items(), key=lambda t: natural_key(t[1].name)):
            if number in self._source_of:
                left += self._left.get(number, [])
            elif count := self.counts.get(number, 0):
                vectors = ", ".join(map(str, self._left.get(number, [])))
                kind = f"{topic.type_name} ({topic.encoding or 'no encoding'})"
                left.append(Content(topic.name, f"{kind}{': ' * bool(vectors)}{vectors}", count))
        return describe_unread(left)

    # -- choosing -----------------------------------------------------------------------------

    def _count(self, block: MessageBlock, channels: NDArray[np.int64]) -> None:
        counts = np.bincount(channels)
        for number in np.flatnonzero(counts).tolist():
            count = int(counts[number])
            self.counts[number] = self.counts.get(number, 0) + count
            if self._lane_of[number] == _UNDECIDED:
                payload = block.payload(int(np.argmax(channels == number)))
                self._lane_of[number] = self._decide(number, payload, count)

    def _decide(self, number: int, payload: bytes, count: int) -> int:
        """The lane of a channel by its first message; `count` of its messages are at hand."""
        topic = self.topics.get(number)
        if topic is None:
            self._orphans += count
            self._fail("a message belongs to a channel that the file never defines")
            return _UNDECIDED
        imu, bare = is_imu(topic), topic.name.removesuffix(f"#{topic.id}")
        self._imus |= {bare} if imu else set()
        stated = self._any_stated and is_stated(self.mapping, topic)
        if not (stated if self._any_stated else bare in self._imus or not self._imus):
            return _SKIPPED
        try:
            decoder = self._decoder(topic)
            look = decoder.look(payload)
            found = source_of(topic, look, self.mapping)
            self._left[number] = [] if imu else list_left(decoder, look, payload, found)
            if found is None:
                return _SKIPPED
            source = self.sources.setdefault(topic.name, found)
            if source.groups != found.groups:
                raise LayoutError("its fields differ within the file")
            source.imu |= imu  # another encoding may have come first
        except LayoutError as error:
            why = str(error)
        except UsageError as error:
            if stated or imu:
                raise
            why = str(error)
        else:
            self._source_of[number] = source
            return self._lane(decoder, source)
        self.reasons[topic.name] = why
        if not (stated or imu or topic.name in self.sources):
            return _SKIPPED
        self._fail(f"topic {topic.name} cannot be decoded: {why}")
        self._undecoded[topic.name] = self._undecoded.get(topic.name, 0) + count
        return _UNDECIDED  # its first message may be the damaged one: the next block may do

    def _decoder(self, topic: Topic) -> Decoder:
        schema = topic.schema
        key = (topic.encoding, schema and (schema.name, schema.encoding, schema.data))
        if key not in self._decoders:
            self._decoders[key] = decoder_for(topic)
        return self._decoders[key]

    def _lane(self, decoder: Decoder, source: TopicSource) -> int:
        for number, lane in enumerate(self._lanes):
            if lane.decoder is decoder and lane.groups == source.groups:
                return number
        self._lanes.append(_Lane(decoder, source.groups, source.instant is not None))
        return len(self._lanes) - 1

    def _fail(self, what: str) -> None:
        if self.log.strict:
            raise UnreadableInput(what, where=str(self.log.path), remedy="read it without strict")

    # -- decoding -----------------------------------------------------------------------------

    def _decode(self, lane: _Lane, block: MessageBlock, channels: NDArray[np.int64]) -> None:
        columns, good, problem, rows = lane.decoder.decode(block, lane.groups)
        log = block.header("publish_time" if self.mapping.time == "publish_time" else "log_time")
        if rows is not None:
            for number in np.unique(channels).tolist():  # a list counts by its elements
                more = np.count_nonzero(channels[rows] == number) - np.count_nonzero(
                    channels == number
                )
                self._source_of[number].more += int(more)
            channels, log = channels[rows], log[rows]
        instants: NDArray[Any] | None = None
        if lane.timed:
            *columns, instants = columns
            if instants.dtype.kind == "f":
                good = good & np.isfinite(instants).all(axis=1)
        if not good.all():
            self._drop(channels[~good], problem or "a time stamp is not a number")
            channels, log, columns = channels[good], log[good], [c[good] for c in columns]
            instants = instants[good] if instants is not None else None
        # Copies, so that the block's bytes are free.
        columns = [c.astype(np.float64) for c in columns]
        stamps = None if instants is None else _join(instants)
        lane.waiting.append(_Rows(channels, stamps, log, columns))
        lane.rows += channels.size

    def _drop(self, channels: NDArray[np.int64], problem: str) -> None:
        for number, count in zip(*np.unique(channels, return_counts=True), strict=True):
            source = self._source_of[int(number)]
            source.bad += int(count)
            source.problem = problem
            self._fail(f"topic {source.name}: {problem}")

    def _divide_all(self) -> Iterator[TopicSamples]:
        for lane in self._lanes:
            yield from self._divide(lane)

    def _divide(self, lane: _Lane) -> Iterator[TopicSamples]:
        """What waits in a lane, topic by topic."""
        waiting, lane.waiting, lane.rows = lane.waiting, [], 0
        if not waiting:
            return
        channels = np.concatenate([w.channels for w in waiting])
        log = np.concatenate([w.log for w in waiting])
        stamps = np.concatenate([w.stamps for w in waiting]) if lane.timed else None
        columns = list(map(np.concatenate, zip(*(w.columns for w in waiting), strict=True)))
        del waiting
        for number in np.flatnonzero(np.bincount(channels)).tolist():
            source, rows = self._source_of[number], np.flatnonzero(channels == number)
            source.rows += rows.size
            own = stamps[rows] if stamps is not None else None
            low, high = self._spans.get(number, (1 << 64, 0))
            self._spans[number] = min(low, int(log[rows].min())), max(high, int(log[rows].max()))
            order = _order_of(log[rows] if own is None else own, log[rows])
            if order is not None:
                source.moved += int(np.count_nonzero(order != np.arange(order.size)))
                rows, own = rows[order], own if own is None else own[order]
            yield TopicSamples(source, own, log[rows], [c[rows] for c in columns])


def _order_of(stamps: Stamps, log: NDArray[np.int64]) -> NDArray[np.intp] | None:
    """The order of log_time, where that puts stamps in order and makes their steps more alike than
    they are in the file: after a clock was set back, where both count alike, it does not."""
    if not (np.diff(stamps) < 0).any():
        return None
    order = np.argsort(log, kind="stable")
    steps = np.diff(stamps[order])
    own, usual = np.diff(stamps), np.median(steps)
    alike = [np.count_nonzero(np.abs(s - usual) <= 0.5 * usual) for s in (steps, own)]
    return order if (steps >= 0).all() and alike[0] > alike[1] else None


def _join(instants: NDArray[Any]) -> Stamps:
    """(n,) stamps: seconds and nanoseconds as int64 ns, a single number as it is."""
    if instants.shape[1] == 2:
        pair = instants.astype(np.int64)
        return np.asarray(pair[:, 0] * 1_000_000_000 + pair[:, 1])
    only = instants[:, 0]
    return only.astype(np.float64 if only.dtype.kind == "f" else np.int64)
