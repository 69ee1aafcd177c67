"""One pass over a log that turns the wanted topics' messages into columns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.errors import ImucalError, UnreadableInput, UsageError
from imucalib.readers.messages.decode import Decoder, decoder_for
from imucalib.readers.messages.definition import LayoutError
from imucalib.readers.messages.fields import TopicFields, is_imu
from imucalib.readers.messages.lanes import DecodedRows, Lane, Samples, Source, joined_stamps
from imucalib.readers.messages.log import MessageLog
from imucalib.readers.messages.records import MessageBlock, Topic
from imucalib.readers.messages.select import fields_of, split_address
from imucalib.recording.mapping import FieldMapping

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
