"""A log of messages as a recording: what the first pass decides, and the channels of the second."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput, UsageError
from imucalib.readers import conversion
from imucalib.readers.columns import listing, suggestion
from imucalib.readers.conversion import Conversion
from imucalib.readers.messages.clock import Clock, Timeline, choose_clock
from imucalib.readers.messages.records import MessageLog
from imucalib.readers.messages.select import (
    QUANTITIES,
    TopicFields,
    Triad,
    contents_of,
    resolved,
    split_address,
    triads_of,
)
from imucalib.readers.messages.stream import Store, TopicStream, checked
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Channel, Gap, Recording

CHANNEL_NAMES = {"acc": "acceleration", "gyro": "angular_rate", "temperature": "temperature"}
_HOUR = 3_600_000_000_000


@dataclass(frozen=True)
class Part:
    """One channel to be: its name and triad, where its values come from, how they become SI; frame:
    the frame_id of its messages, or empty."""

    name: str
    triad: str
    quantity: str
    topic: str
    column: int
    conversion: Conversion
    numbered: bool
    frame: str


@dataclass(frozen=True)
class Plan:
    """What the first pass decided for the whole file."""

    head: Recording  # without channels; its notes and mapping are those of the file
    parts: tuple[Part, ...]
    clocks: dict[str, Clock]
    start_ns: int

    def timelines(self) -> dict[str, Timeline]:
        labels = {part.topic: part.triad for part in reversed(self.parts)}
        return {t: Timeline(c, self.start_ns, labels[t]) for t, c in self.clocks.items()}


class _Topics(NamedTuple):
    fields: dict[str, TopicFields]
    clocks: dict[str, Clock]


def decide(log: MessageLog, mapping: FieldMapping, stream: TopicStream, store: Store) -> Plan:
    """Triads, clocks, units and notes, from everything that the first pass saw."""
    path = log.path
    _refuse_unknown(log, mapping, stream)
    sources = {n: s for n, s in stream.sources.items() if s.rows}
    if any(source.imu for source in sources.values()) and not any((*mapping.acc, *mapping.gyro)):
        sources = {n: s for n, s in sources.items() if s.imu}
    fields = {name: source.fields for name, source in sources.items()}
    alive = {name: store.surveys[name].alive for name in sources}
    triads = triads_of(mapping, fields, alive)
    if not any(triad.parts for triad in triads):
        raise _no_imu(log, stream)
    used = list(dict.fromkeys(t for triad in triads for t, _ in triad.parts.values()))
    clocks = _clocks({name: fields[name] for name in used}, mapping, store, str(path))
    parts, notes = _parts(path, mapping, triads, store, _Topics(fields, clocks))
    notes = [*_described(triads, fields, clocks, alive), *notes, *stream.losses()]
    marks = tuple(dict.fromkeys(stream.scanner.corrections))
    notes += map(str, marks)
    start, dated = _origin([fields[name] for name in used], list(clocks.values()))
    states = {part.quantity: part.conversion.source_unit for part in reversed(parts)}
    found = resolved(mapping, triads, fields, [states.get("acc", ""), states.get("gyro", "")])
    head = Recording(
        channels={},
        path=str(path),
        format=log.format,
        sha256=log.sha256(),
        start_ns=start if dated else None,
        gaps=(),
        notes=tuple(notes),
        mapping=found.to_dict(),
        corrections=marks,
    )
    return Plan(head, tuple(parts), clocks, start)


def _refuse_unknown(log: MessageLog, mapping: FieldMapping, stream: TopicStream) -> None:
    for quantity in QUANTITIES:
        for text in getattr(mapping, quantity):
            if text and all(split_address(text, t) is None for t in stream.topics()):
                raise UsageError(
                    f"'{text}' is not a topic of {log.path}, which holds:"
                    f"{listing(contents_of(log)) or ' none'}\n",
                    where=f"mapping: {quantity}",
                    remedy="Write it as TOPIC or TOPIC:FIELD",
                )


def _no_imu(log: MessageLog, stream: TopicStream) -> UnreadableInput:
    """The error for a file without a topic to read, with everything that it has."""
    held = contents_of(log)
    reasons = stream.reasons()
    named = tuple(replace(c, why=c.why or reasons.get(c.address, "")) for c in held)
    lost = "; ".join(stream.losses())
    return UnreadableInput(
        f"no IMU topic was found among:{listing(named) or ' none'}\n"
        + (f"{lost}\n" if lost else ""),
        where=str(log.path),
        remedy=f"Name the fields with --acc TOPIC:FIELD and --gyro TOPIC:FIELD{suggestion(held)}",
    )


def _origin(topics: list[TopicFields], clocks: list[Clock]) -> tuple[int, bool]:
    """ns of t = 0, and whether it is a date: as the file states it, else the first sample's."""
    stated = {(fields.origin_ns, fields.dated) for fields in topics}
    stamped = all(clock.source == "stamp" for clock in clocks)
    origin, dated = next(iter(stated))
    if len(stated) == 1 and stamped and origin is not None:
        return origin, dated
    return min(clock.first for clock in clocks), all(clock.dated for clock in clocks)


def _clocks(
    topics: dict[str, TopicFields], mapping: FieldMapping, store: Store, where: str
) -> dict[str, Clock]:
    """A clock for each topic; one clock for all where their stamps tell of different epochs."""

    def clock(name: str, fields: TopicFields, apart: str = "") -> Clock:
        survey = store.surveys[name] if fields.time_leaves else store.without_stamps(name)
        return choose_clock(
            survey,
            scalar=len(fields.time_leaves) == 1,
            time_unit=mapping.time_unit,
            rate=mapping.rate,
            apart=apart,
            where=f"{where}, topic {name}",
        )

    clocks = {name: clock(name, fields) for name, fields in topics.items()}
    starts = [one.first for one in clocks.values()]
    logs = [store.surveys[name].log.low for name in clocks]
    if max(starts) - min(starts) <= max(logs) - min(logs) + _HOUR:
        return clocks
    seconds = (max(starts) - min(starts)) * 1e-9
    apart = f"the stamps of its topics count from epochs {seconds:.6g} s apart"
    return {name: clock(name, TopicFields(()), apart) for name in topics}


def _parts(
    path: Path, mapping: FieldMapping, triads: list[Triad], store: Store, topics: _Topics
) -> tuple[list[Part], list[str]]:
    parts, notes = [], []
    for triad in triads:
        for quantity, (topic, column) in triad.parts.items():
            stated = topics.fields[topic].fields[column].unit
            pieces = store.surveys[topic].rest_pieces(column)
            period = topics.clocks[topic].period
            convert = _conversion(
                quantity, mapping, stated, pieces, period=period, where=f"{path}, topic {topic}"
            )
            if convert.note:
                notes.append(f"{triad.name}: {convert.note}")
            name = f"{triad.name}/{CHANNEL_NAMES[quantity]}"
            parts.append(
                Part(
                    name=name,
                    triad=triad.name,
                    quantity=quantity,
                    topic=topic,
                    column=column,
                    conversion=convert,
                    numbered=triad.numbered,
                    frame=topics.fields[topic].frame,
                )
            )
    return parts, notes


def _conversion(
    quantity: str,
    mapping: FieldMapping,
    stated: str,
    pieces: list[Array],
    *,
    period: float,
    where: str,
) -> Conversion:
    if quantity == "acc":
        window = int(np.clip(0.5e9 / period, 16, 1024)) if period else 16
        return conversion.acceleration(
            mapping, stated, conversion.readings_at_rest(pieces, window), where
        )
    if quantity == "gyro":
        return conversion.angular_rate(mapping, stated, where)
    return conversion.temperature(mapping, stated, np.concatenate(pieces), where)


def _described(
    triads: list[Triad],
    topics: dict[str, TopicFields],
    clocks: dict[str, Clock],
    alive: dict[str, list[bool]],
) -> list[str]:
    notes = []
    for triad in triads:
        for topic in dict.fromkeys(name for name, _ in triad.parts.values()):
            clock = clocks[topic]
            source = topics[topic].time if clock.source == "stamp" else clock.source
            lines = "; ".join(clock.notes)
            notes.append(f"{triad.name}: topic {topic}, time from {source}: {lines}")
    for topic, flags in alive.items():
        for f, living in zip(topics[topic].fields, flags, strict=True):
            if not living:
                notes.append(f"topic {topic}: {f.address} is always zero")
    return notes


def read_log(log: MessageLog, mapping: FieldMapping, *, strict: bool) -> Recording:
    """Read all samples in one pass; peak memory is the result and one spare channel."""
    stream, store, plan = planned(log, mapping, strict=strict)
    store.surveys.clear()  # they hold on to raw samples
    outputs = {}
    gaps: list[Gap] = []
    timelines = plan.timelines()
    for topic, timeline in timelines.items():
        marks = stream.sources[topic].marks
        stamps, times, columns = store.taken(topic, needs_stamps=timeline.clock.source == "stamp")
        pieces = [timeline.push(stamps, times, columns, marks), timeline.flush(marks)]
        done = [piece for piece in pieces if piece]
        gaps += [gap for piece in done for gap in piece[2]]
        outputs[topic] = [(t, values) for t, values, _ in done]
    notes = (*plan.head.notes, *_missing(timelines))
    return _recording(plan, outputs, gaps, notes)


def planned(
    log: MessageLog, mapping: FieldMapping, *, strict: bool
) -> tuple[TopicStream, Store, Plan]:
    """One whole pass: every sample, in file order, and what was decided for them."""
    try:
        stream, store = _collect(log, mapping, strict, keep=True)
        return stream, store, decide(log, mapping, stream, store)
    except OSError as error:
        raise checked(error, log.path) from error


def log_blocks(
    log: MessageLog, mapping: FieldMapping, *, block_samples: int, strict: bool
) -> Iterator[Recording]:
    """Read the log twice: what holds for all of it first, then the samples in blocks."""
    try:
        stream, store = _collect(log, mapping, strict, keep=False)
        plan = decide(log, mapping, stream, store)
        del stream, store  # the second pass needs the decisions only
        yield from _emit(log, mapping, plan, block_samples)
    except OSError as error:
        raise checked(error, log.path) from error


def _collect(
    log: MessageLog, mapping: FieldMapping, strict: bool, *, keep: bool
) -> tuple[TopicStream, Store]:
    stream = TopicStream(log, mapping, strict=strict)
    store = Store(keep, stream.expected)
    for samples in stream.samples():
        store.add(samples)
    store.close()
    return stream, store


def _missing(timelines: dict[str, Timeline]) -> list[str]:
    return [
        f"{line.label}: {line.missing} samples are missing in short steps, below a gap's length"
        for line in timelines.values()
        if line.missing
    ]


def _emit(
    log: MessageLog, mapping: FieldMapping, plan: Plan, block_samples: int
) -> Iterator[Recording]:
    # The first pass has raised already if the file must be whole.
    stream = TopicStream(log, mapping, strict=False, gather=block_samples)
    timelines = plan.timelines()
    outputs: dict[str, list[tuple[Array, list[Array]]]] = {name: [] for name in timelines}
    gaps: list[Gap] = []
    notes, waiting = plan.head.notes, 0  # samples of all topics: that is what takes memory
    for samples in stream.samples():
        if samples.topic not in timelines:
            continue
        marks = stream.sources[samples.topic].marks
        columns = [np.array(c, dtype=np.float64) for c in samples.columns]
        t, values, found = timelines[samples.topic].push(
            samples.stamps, samples.log, columns, marks
        )
        gaps += found
        outputs[samples.topic].append((t, values))
        waiting += t.size
        if waiting >= block_samples:
            yield _recording(plan, outputs, gaps, notes)
            outputs, gaps, notes, waiting = {name: [] for name in timelines}, [], (), 0
    for name, timeline in timelines.items():
        last = timeline.flush(stream.sources[name].marks)
        if last:
            outputs[name].append(last[:2])
            gaps += last[2]
    notes = (*notes, *_missing(timelines))
    if notes or gaps or any(t.size for parts in outputs.values() for t, _ in parts):
        yield _recording(plan, outputs, gaps, notes)


def _recording(
    plan: Plan,
    outputs: dict[str, list[tuple[Array, list[Array]]]],
    gaps: list[Gap],
    notes: tuple[str, ...],
) -> Recording:
    times: dict[str, Array] = {}
    channels: dict[str, Channel] = {}
    for part in plan.parts:
        pieces = outputs[part.topic]
        if not any(t.size for t, _ in pieces):
            continue
        if part.topic not in times:
            times[part.topic] = _whole([t for t, _ in pieces])
        values = part.conversion.apply(_whole([columns[part.column] for _, columns in pieces]))
        period = plan.clocks[part.topic].period
        channels[part.name] = Channel(
            t=times[part.topic],
            values=values,
            unit=part.conversion.unit,
            quantity=CHANNEL_NAMES[part.quantity],
            triad=part.triad,
            rate=1e9 / period if period else 0.0,
            names=(part.topic, part.frame) if part.frame else (part.topic,),
            numbered=part.numbered,
        )
    head, ordered = plan.head, sorted(gaps, key=lambda gap: (gap.start, gap.stop, gap.reason))
    return Recording(
        channels=channels,
        path=head.path,
        format=head.format,
        sha256=head.sha256,
        start_ns=head.start_ns,
        gaps=tuple(ordered),
        notes=notes,
        mapping=head.mapping,
        corrections=head.corrections,
    )


def _whole(pieces: list[Array]) -> Array:
    return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)
