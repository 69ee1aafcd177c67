"""Recordings out of logs of messages: one pass decides, the samples become channels."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imucalib.arrays import Array
from imucalib.readers.messages.log import MessageLog
from imucalib.readers.messages.plan import CHANNEL_NAMES, Plan, decide
from imucalib.readers.messages.store import Store
from imucalib.readers.messages.stream import TopicStream, checked
from imucalib.readers.messages.timeline import Timeline
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Channel, Gap, Recording


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
