"""A log of messages as a recording: what the first pass decides, and the channels of the second."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput, UsageError
from imucalib.readers.fields import conversion
from imucalib.readers.fields.choice import OPTIONS
from imucalib.readers.fields.contents import listing, suggestion
from imucalib.readers.fields.conversion import Conversion
from imucalib.readers.messages.records import MessageLog
from imucalib.readers.messages.select import (
    TopicTriad,
    contents_of,
    split_address,
    triads_of,
)
from imucalib.readers.messages.stream import GATHER, TopicStream
from imucalib.readers.messages.topics import (
    Timeline,
    TopicClock,
    TopicSamples,
    TopicSource,
    choose_clock,
)
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Channel, Recording

_HOUR = 3_600_000_000_000  # ns


@dataclass(frozen=True)
class ChannelPlan:
    """One channel to be: which column of its topic it is, how its values become SI; channel : all
    but its samples."""

    column: int
    conversion: Conversion
    channel: Channel

    @property
    def name(self) -> str:
        """Of the channel."""
        return f"{self.channel.triad}/{self.channel.quantity}"

    @property
    def topic(self) -> str:
        """That it comes from."""
        return self.channel.topic


@dataclass(frozen=True)
class MessagePlan:
    """What the first pass decided for the whole file.

    head : without channels; its notes and mapping are those of the file
    """

    head: Recording
    parts: tuple[ChannelPlan, ...]
    clocks: dict[str, TopicClock]
    start_ns: int

    def timelines(self) -> dict[str, Timeline]:
        """The clocks at work, by topic."""
        labels = {part.topic: part.channel.triad for part in reversed(self.parts)}
        return {t: Timeline(c, self.start_ns, labels[t]) for t, c in self.clocks.items()}


class FirstPass:
    """One whole pass: what was decided, and with `keep` every sample."""

    def __init__(self, log: MessageLog, mapping: FieldMapping, *, keep: bool) -> None:
        self._survey(log, mapping, frozenset(), keep=keep)
        if apart := self.stream.overlapping():
            self._survey(log, mapping, apart, keep=keep)
        self.plan = _decide(self.stream)
        for source in self.stream.sources.values():
            source.pieces.clear()

    def _survey(
        self, log: MessageLog, mapping: FieldMapping, apart: frozenset[int], *, keep: bool
    ) -> None:
        self.stream = TopicStream(log, mapping, apart)
        self._kept: dict[str, list[list[NDArray[Any]]]] = {}  # log times, columns, stamps
        for samples in self.stream.samples():
            samples.source.survey(samples)
            if keep:
                parts = [samples.log, *samples.columns]
                parts += [] if samples.stamps is None else [samples.stamps]
                kept = self._kept.setdefault(samples.source.name, [[] for _ in parts])
                for pieces, part in zip(kept, parts, strict=True):
                    pieces.append(part)

    def samples(self, topic: str) -> TopicSamples:
        """All samples of a topic, handed over; memory holds one column twice."""
        source, whole = self.stream.sources[topic], list[NDArray[Any]]()
        for pieces in self._kept.pop(topic):
            whole.append(np.concatenate(pieces))
            pieces.clear()
        log, *columns = whole
        return TopicSamples(source, columns.pop() if source.instant else None, log, columns)


class LogReader(ABC):
    """A reader of logs of messages; see `imucalib.readers.Reader`."""

    @abstractmethod
    def open(self, path: Path, mapping: FieldMapping, *, strict: bool = False) -> MessageLog:
        """The log in a file or folder; `strict` as in `MessageLog`."""

    def read(self, path: Path, mapping: FieldMapping, *, strict: bool) -> Recording:
        """Read all samples in one pass; peak memory is the result and one spare channel."""
        first = FirstPass(self.open(path, mapping, strict=strict), mapping, keep=True)
        kept = (first.samples(topic) for topic in first.plan.clocks)
        (whole,) = _recordings(first.plan, kept, block_samples=math.inf)
        return whole

    def blocks(
        self, path: Path, mapping: FieldMapping, *, block_samples: int, strict: bool
    ) -> Iterator[Recording]:
        """Read the log twice: what holds for all of it first, then the samples in blocks."""
        log = self.open(path, mapping, strict=strict)
        first = FirstPass(log, mapping, keep=False)
        stream = TopicStream(log, mapping, first.stream.apart, gather=min(block_samples, GATHER))
        yield from _recordings(first.plan, stream.samples(), block_samples=block_samples)


def _recordings(
    plan: MessagePlan, samples: Iterable[TopicSamples], *, block_samples: float
) -> Iterator[Recording]:
    timelines = plan.timelines()
    notes, waiting = plan.head.notes, 0  # samples of all topics: that is what takes memory
    for some in samples:
        if some.source.name not in timelines:
            continue
        timelines[some.source.name].push(some)
        waiting += some.log.size
        if waiting >= block_samples:
            yield _recording(plan, timelines, notes)
            notes, waiting = (), 0
    for line in timelines.values():
        line.finish()
        if line.missing:
            missing = "samples are missing in short steps, below a gap's length"
            notes = (*notes, f"{line.label}: {line.missing} {missing}")
    last = _recording(plan, timelines, notes)
    if last.notes or last.gaps or last.channels:
        yield last


def _recording(
    plan: MessagePlan, timelines: dict[str, Timeline], notes: tuple[str, ...]
) -> Recording:
    """What is final of the timelines, which give it up."""
    channels: dict[str, Channel] = {}
    times = {topic: _whole(line.t) for topic, line in timelines.items() if line.t}
    for part in plan.parts:
        if part.topic in times:
            pieces = timelines[part.topic].columns
            values = part.conversion.apply(_whole([columns[part.column] for columns in pieces]))
            channels[part.name] = replace(part.channel, t=times[part.topic], values=values)
    gaps = [gap for line in timelines.values() for gap in line.gaps]
    gaps.sort(key=lambda gap: (gap.start, gap.stop, gap.reason))
    for line in timelines.values():
        line.t, line.columns, line.gaps = [], [], []
    return replace(plan.head, channels=channels, gaps=tuple(gaps), notes=notes)


def _whole(pieces: list[Array]) -> Array:
    return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)


# -- what the first pass decides --------------------------------------------------------------


def _decide(stream: TopicStream) -> MessagePlan:
    """Triads, clocks, units and notes, from everything that the first pass saw."""
    log, mapping = stream.log, stream.mapping
    _refuse_unknown(stream)
    sources = {name: source for name, source in stream.sources.items() if source.rows}
    if any(source.imu for source in sources.values()) and not any((*mapping.acc, *mapping.gyro)):
        sources = {name: source for name, source in sources.items() if source.imu}
    triads = triads_of(mapping, sources)
    if not any(triad.parts for triad in triads):
        raise _no_imu(stream)
    used = list(dict.fromkeys(topic for triad in triads for topic, _ in triad.parts.values()))
    clocks = _clocks([sources[name] for name in used], mapping, str(log.path))
    parts = [
        _plan_channel(
            triad, quantity, sources[name], clocks[name], mapping, f"{log.path}, topic {name}"
        )
        for triad in triads
        for quantity, (name, _) in triad.parts.items()
    ]
    notes = _clock_notes(triads, sources, clocks)
    notes += [f"{p.channel.triad}: {p.conversion.note}" for p in parts if p.conversion.note]
    marks = tuple(dict.fromkeys(log.corrections))
    start, dated = _origin([sources[name] for name in used], list(clocks.values()))
    head = Recording(
        channels={},
        path=str(log.path),
        format=log.format,
        sha256=log.sha256(),
        start_ns=start if dated else None,
        notes=(*notes, *stream.losses(), *map(str, marks), *stream.describe_unread()),
        mapping=_resolve(mapping, triads, sources, parts).to_dict(),
        corrections=marks,
        counts=tuple(c for c in stream.tallies() if c.source.removeprefix("messages of ") in used),
    )
    return MessagePlan(head, tuple(parts), clocks, start)


def _refuse_unknown(stream: TopicStream) -> None:
    for option in OPTIONS.values():
        for text in getattr(stream.mapping, option):
            if text and all(split_address(text, t) is None for t in stream.topics.values()):
                raise UsageError(
                    f"'{text}' is not a topic of {stream.log.path}, which holds:"
                    f"{listing(contents_of(stream.log, stream.topics)) or ' none'}\n",
                    where=f"mapping: {option}",
                    remedy="Write it as TOPIC or TOPIC:FIELD",
                )


def _no_imu(stream: TopicStream) -> UnreadableInput:
    """The error for a file without a topic to read, with everything that it has."""
    lost = "; ".join(stream.losses())
    held = contents_of(stream.log, stream.topics)
    named = tuple(replace(c, why=c.why or stream.reasons.get(c.address, "")) for c in held)
    return UnreadableInput(
        f"no IMU topic was found among:{listing(named) or ' none'}\n"
        + (f"{lost}\n" if lost else ""),
        where=str(stream.log.path),
        remedy=f"Name the fields with --acc TOPIC:FIELD and --gyro TOPIC:FIELD{suggestion(held)}",
    )


def _clocks(sources: list[TopicSource], mapping: FieldMapping, where: str) -> dict[str, TopicClock]:
    """A clock for each topic; one clock for all where their stamps count from other epochs."""

    def clocks(apart: str) -> dict[str, TopicClock]:
        return {
            source.name: choose_clock(source, mapping, f"{where}, topic {source.name}", apart)
            for source in sources
        }

    found = clocks("")
    starts, logs = [c.first for c in found.values()], [source.log.low for source in sources]
    apart = max(starts) - min(starts)
    if apart <= max(logs) - min(logs) + _HOUR:
        return found
    return clocks(f"the stamps of its topics count from epochs {apart * 1e-9:.6g} s apart")


def _plan_channel(
    triad: TopicTriad,
    quantity: str,
    source: TopicSource,
    clock: TopicClock,
    mapping: FieldMapping,
    where: str,
) -> ChannelPlan:
    """One quantity of a triad: how its values become SI, from what is stated and from the values,
    and the channel that they make."""
    _, column = triad.parts[quantity]
    rate = 1e9 / clock.period if clock.period else 0.0
    stated, looks = conversion.UnitSource(source.fields[column].unit), source.rest_pieces(column)
    how = conversion.find_conversion(quantity, mapping, stated, looks, rate=rate, where=where)
    channel = Channel(
        t=np.empty(0),
        values=np.empty((0, source.fields[column].group.width)),
        quantity=quantity,
        triad=triad.name,
        rate=rate,
        names=(source.name, source.frame) if source.frame else (source.name,),
        numbered=triad.numbered,
        topic=source.name,
        **how.units,
    )
    return ChannelPlan(column, how, channel)


def _clock_notes(
    triads: list[TopicTriad], sources: Mapping[str, TopicSource], clocks: dict[str, TopicClock]
) -> list[str]:
    notes = []
    for triad in triads:
        for topic in dict.fromkeys(name for name, _ in triad.parts.values()):
            clock = clocks[topic]
            place = sources[topic].time if clock.source == "stamp" else clock.source
            lines = "; ".join(clock.notes)
            notes.append(f"{triad.name}: topic {topic}, time from {place}: {lines}")
    for name, source in sources.items():
        for f, alive in zip(source.fields, source.alive, strict=True):
            if not alive:
                notes.append(f"topic {name}: {f.address} is always zero")
    return notes


def _origin(sources: list[TopicSource], clocks: list[TopicClock]) -> tuple[int, bool]:
    """ns of t = 0, and whether it is a date: as the file states it, else the first sample's."""
    stated = {(source.origin_ns, source.dated) for source in sources}
    stamped = all(clock.source == "stamp" for clock in clocks)
    origin, dated = next(iter(stated))
    if len(stated) == 1 and stamped and origin is not None:
        return origin, dated
    return min(clock.first for clock in clocks), all(clock.dated for clock in clocks)


def _resolve(
    mapping: FieldMapping,
    triads: list[TopicTriad],
    sources: Mapping[str, TopicSource],
    parts: list[ChannelPlan],
) -> FieldMapping:
    """The mapping that reads the same channels again."""
    found: dict[str, tuple[str, ...]] = {}
    for quantity in OPTIONS:
        texts = []
        for triad in triads:
            name, i = triad.parts.get(quantity, ("", 0))
            texts.append(f"{name}:{sources[name].fields[i].address}" if name else "")
        found[quantity] = tuple(texts) if any(texts) else ()
    units = {p.channel.quantity: p.conversion.source_unit for p in reversed(parts)}
    return replace(
        mapping,
        acc=found["acceleration"],
        gyro=found["angular_rate"],
        temperature=found["temperature"],
        triads=tuple(triad.name for triad in triads),
        acc_unit=mapping.acc_unit or units.get("acceleration", ""),
        gyro_unit=mapping.gyro_unit or units.get("angular_rate", ""),
    )
