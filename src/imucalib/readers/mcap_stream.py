"""One pass over an MCAP file that turns the wanted topics' messages into columns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucalib.errors import ImucalError, UnreadableInput, UsageError
from imucalib.mapping import FieldMapping
from imucalib.readers.mcap_decode import Decoded, Decoder, decoder_for
from imucalib.readers.mcap_fields import TopicFields, is_imu
from imucalib.readers.mcap_layout import Groups, LayoutError
from imucalib.readers.mcap_records import MessageBlock, Topic
from imucalib.readers.mcap_scan import Scanner, known_topics
from imucalib.readers.mcap_select import fields_of, natural, split_address

_UNDECIDED, _SKIPPED = -1, -2


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


class _Lane(NamedTuple):
    """Topics that decode together: one decoder, the same groups."""

    decoder: Decoder
    groups: Groups
    widths: tuple[int, ...]


class TopicStream:
    """Reads the topics that the mapping wants; `sources`, `counts` and notes fill meanwhile."""

    def __init__(self, path: Path, mapping: FieldMapping, *, strict: bool) -> None:
        self.path, self.mapping, self.strict = path, mapping, strict
        self.scanner = Scanner(path, strict=strict)
        self.sources: dict[str, Source] = {}
        self.counts: dict[int, int] = {}
        self.orphans = 0
        self._hints = known_topics(path)
        self._imu_known = any(is_imu(topic) for topic in self._hints.values())
        self._lane_of = np.full(1 << 16, _UNDECIDED, dtype=np.int64)
        self._lanes: list[_Lane] = []
        self._decoders: dict[tuple[object, ...], Decoder] = {}
        self._source_of: dict[int, Source] = {}
        self._reasons: dict[int, str] = {}

    def samples(self) -> Iterator[Samples]:
        """All wanted samples, a chunk at a time."""
        damages = 0
        for block in self.scanner.blocks():
            if len(self.scanner.damages) != damages:
                damages = len(self.scanner.damages)
                for source in self.sources.values():
                    source.marks.append(source.rows)
            channels = block.header("channel").astype(np.int64)
            self._count(block, channels)
            lanes = self._lane_of[channels]
            for number in range(len(self._lanes)):
                rows = np.flatnonzero(lanes == number)
                if rows.size:
                    order = np.argsort(channels[rows], kind="stable")
                    rows = rows[order]
                    yield from self._decode(self._lanes[number], block.take(rows), channels[rows])

    def topic(self, number: int) -> Topic | None:
        """The topic of a channel number, from the data or else from the file's summary."""
        return self.scanner.topics.get(number) or self._hints.get(number)

    def candidates(self) -> list[str]:
        """Every topic with its type, count and, where it could not be read, the reason."""
        lines = []
        for number, topic in {**self._hints, **self.scanner.topics}.items():
            reason = self._reasons.get(number, "")
            text = f"{topic.name} ({topic.type_name}, {topic.encoding or 'no encoding'}, "
            text += f"{self.counts.get(number, 0)} messages{': ' if reason else ''}{reason})"
            lines.append(text)
        return sorted(lines, key=natural)

    def losses(self) -> list[str]:
        """Notes on what was damaged or could not be decoded."""
        notes = [f"damaged at {damage}" for damage in self.scanner.damages]
        for source in self.sources.values():
            if source.bad:
                notes.append(
                    f"{source.name}: {source.bad} messages cannot be decoded and are left out"
                    f" ({source.problem})"
                )
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
        if stated is False or (stated is None and self._imu_known and not imu):
            return _SKIPPED
        try:
            decoder = self._decoder(topic)
            fields = fields_of(topic, decoder.leaves(payload), self.mapping)
        except LayoutError as error:
            return self._refuse(number, topic, str(error), bool(stated or imu), count)
        except UsageError as error:
            if stated:
                raise
            return self._refuse(number, topic, str(error), False, count)
        if fields is None:
            return _SKIPPED
        source = self.sources.setdefault(topic.name, Source(topic.name, fields, imu))
        if source.fields.groups != fields.groups:
            return self._refuse(number, topic, "its fields differ within the file", True, count)
        self._source_of[number] = source
        lane = _Lane(decoder, fields.groups, fields.widths)
        if lane not in self._lanes:
            self._lanes.append(lane)
        return self._lanes.index(lane)

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
            if topic.name in self.sources:
                self.sources[topic.name].bad += count
                self.sources[topic.name].problem = why
        # Its first message may be the damaged one: the next block gets another chance.
        return _UNDECIDED if wanted else _SKIPPED

    def _fail(self, what: str) -> None:
        if self.strict:
            raise UnreadableInput(what, where=str(self.path), remedy="read it without strict")

    # -- decoding -----------------------------------------------------------------------------

    def _decode(
        self, lane: _Lane, block: MessageBlock, channels: NDArray[np.int64]
    ) -> Iterator[Samples]:
        decoded = lane.decoder.decode(block, lane.groups, lane.widths)
        clock = "publish_time" if self.mapping.time == "publish_time" else "log_time"
        log = block.header(clock).astype(np.int64)
        edges = [0, *(np.flatnonzero(np.diff(channels)) + 1).tolist(), channels.size]
        for a, b in zip(edges[:-1], edges[1:], strict=True):
            source = self._source_of[int(channels[a])]
            samples = self._samples(source, decoded, log, slice(a, b))
            source.rows += samples.log.size
            if samples.log.size:
                yield samples

    def _samples(
        self, source: Source, decoded: Decoded, log: NDArray[np.int64], part: slice
    ) -> Samples:
        good, columns = decoded.good[part], [c[part] for c in decoded.columns]
        log = log[part]
        stamps = None
        if source.fields.time_leaves:
            stamps, columns = columns[-1], columns[:-1]
            if stamps.dtype.kind == "f":
                good = good & np.isfinite(stamps).all(axis=1)
        if not good.all():
            source.bad += int(good.size - good.sum())
            source.problem = decoded.problem or "a time stamp is not a number"
            self._fail(f"topic {source.name}: {source.problem}")
            log, columns = log[good], [c[good] for c in columns]
            stamps = stamps[good] if stamps is not None else None
        return Samples(
            source.name, _joined(stamps) if stamps is not None else None, log, columns
        )


def _joined(stamps: NDArray[Any]) -> NDArray[Any]:
    """(n,) stamps: seconds and nanoseconds as int64 ns, a single number as it is."""
    if stamps.shape[1] == 2:
        pair = stamps.astype(np.int64)
        total: NDArray[np.int64] = pair[:, 0] * 1_000_000_000 + pair[:, 1]
        return total
    only = stamps[:, 0]
    return only.astype(np.float64 if only.dtype.kind == "f" else np.int64)


def checked(error: Exception, path: Path) -> ImucalError:
    """A failure of the operating system while reading, in this package's terms."""
    detail = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return UnreadableInput(
        f"the file cannot be read: {detail}", where=str(path), remedy="check the disk or share"
    )
