"""A recording over the MCAP file that it was read from: vectors patched in, the rest copied.

A message is patched where its acceleration and angular rate are runs of doubles in SI units (what
sensor_msgs/Imu is), and keeps every other byte; topics of other kinds are written anew.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.atomic_file import replaced_atomically
from imucalib.readers.mcap import McapLog
from imucalib.readers.messages.decode import RosDecoder, decoder_for
from imucalib.readers.messages.recording import CHANNEL_NAMES, Part, Plan, planned
from imucalib.readers.messages.records import (
    ATTACHMENT,
    CORRECTIONS,
    METADATA,
    MalformedRecordError,
    MessageBlock,
    Topic,
    text_at,
)
from imucalib.readers.messages.stream import Store, TopicStream
from imucalib.recording.mapping import UNCHANGED, from_dict
from imucalib.recording.recording import Recording
from imucalib.writers.mcap import (
    LIBRARY,
    SHORT_NAMES,
    ChunkData,
    McapFile,
    chunks_of,
    define,
    outputs_beside,
    topic_names,
)

_UNITS = {"acc": "m/s2", "gyro": "rad/s"}
_VECTORS = 3


@dataclass
class PatchedTopic:
    """One topic whose messages are kept and whose vectors are replaced.

    number : its channel number; rank : (n,) row of the recording for each message in file order
    vectors : the leaves of each vector in the message, and its new values (n, 3)
    """

    name: str
    number: int
    decoder: RosDecoder
    rank: NDArray[np.int64]
    vectors: list[tuple[tuple[str, ...], Array]]
    done: int = 0

    def located(self, block: MessageBlock) -> list[NDArray[np.int64]]:
        """Of each vector (n,) where it begins in the payload; -1 unknown, -2 - at: big-endian."""
        found = []
        for leaves, _ in self.vectors:
            places = np.full(block.starts.size, -1, dtype=np.int64)
            for rows, offset, order in self.decoder.located(block, leaves):
                if offset >= 0:
                    places[rows] = offset if order == "<" else -2 - offset
            found.append(places)
        return found


@dataclass(frozen=True)
class Patch:
    """Topics to patch by channel number, and the recording's channels that they hold."""

    topics: dict[int, PatchedTopic]
    channels: frozenset[str]

    def apply(
        self, block: MessageBlock, channels: NDArray[np.int64]
    ) -> tuple[MessageBlock, NDArray[np.bool_]]:
        """The block with its vectors replaced, and which of its messages could not be patched."""
        data: NDArray[np.uint8] | None = None
        lost = np.zeros(channels.size, dtype=np.bool_)
        for number, topic in self.topics.items():
            rows = np.flatnonzero(channels == number)
            if not rows.size:
                continue
            if data is None:
                data = np.frombuffer(bytearray(block.data), dtype=np.uint8)
            places = topic.located(block.take(rows))
            known = np.all([p != -1 for p in places], axis=0)
            lost[rows[~known]] = True
            order = topic.rank[topic.done : topic.done + int(known.sum())]
            topic.done += order.size
            starts = block.starts[rows[known]]
            for place, (_, values) in zip(places, topic.vectors, strict=True):
                _overwrite(data, starts, place[known], values[order])
        if data is None:
            return block, lost
        return MessageBlock(data.tobytes(), block.starts, block.lengths, block.offset), lost


def _overwrite(
    data: NDArray[np.uint8], starts: NDArray[np.int64], places: NDArray[np.int64], values: Array
) -> None:
    for form, mask in (("<f8", places >= 0), (">f8", places < 0)):
        if mask.any():
            offsets = places[mask] if form == "<f8" else -2 - places[mask]
            raw = np.ascontiguousarray(values[mask], dtype=form).view(np.uint8)
            data[(starts[mask] + offsets)[:, None] + np.arange(8 * _VECTORS)] = raw


def patch_of(recording: Recording, source: McapLog) -> Patch:
    """What of a recording can be patched into the messages of the file that it was read from."""
    mapping = from_dict(recording.mapping, "mapping of the recording")
    stream, store, plan = planned(source, mapping, strict=False)
    topics = {}
    for name in plan.clocks:
        parts = [part for part in plan.parts if part.topic == name]
        topic = _topic(name, parts, recording, stream)
        if topic is not None:
            topic.rank = _rank(name, plan, store)
            topics[topic.number] = topic
    for number in _miscounted(source, topics):
        del topics[number]
    held = {p.name for p in plan.parts if p.topic in {t.name for t in topics.values()}}
    # A thermometer's topic is never changed: it is copied like any other.
    held |= {p.name for p in plan.parts if p.quantity == "temperature"}
    return Patch(topics, frozenset(held))


def _topic(
    name: str, parts: list[Part], recording: Recording, stream: TopicStream
) -> PatchedTopic | None:
    known: dict[int, Topic] = {n: t for n in stream.counts if (t := stream.topic(n)) is not None}
    numbers = [n for n, topic in known.items() if topic.name == name]
    wanted = [part for part in parts if part.quantity in _UNITS]
    if len(numbers) != 1 or not wanted or not all(_in_place(p, recording) for p in wanted):
        return None
    decoder = decoder_for(known[numbers[0]])
    rows = {recording.channels[part.name].t.size for part in wanted}
    if not isinstance(decoder, RosDecoder) or rows != {stream.sources[name].rows}:
        return None
    fields = stream.sources[name].fields.fields
    vectors = [(fields[p.column].leaves, recording.channels[p.name].values) for p in wanted]
    return PatchedTopic(name, numbers[0], decoder, np.empty(0, dtype=np.int64), vectors)


def _in_place(part: Part, recording: Recording) -> bool:
    """Whether the channel's values are the message's own: SI, no offset, no turned axes."""
    channel, conversion = recording.channels.get(part.name), part.conversion
    plain = conversion.axes == UNCHANGED and not conversion.offset.any()
    same = channel is not None and channel.quantity == CHANNEL_NAMES[part.quantity]
    unit = conversion.source_unit == _UNITS[part.quantity] == (channel.unit if channel else "")
    return same and plain and unit


def _rank(name: str, plan: Plan, store: Store) -> NDArray[np.int64]:
    """For each message in file order, its row in the recording, which is in order of time."""
    clock = plan.clocks[name]
    stamps, log, _ = store.taken(name, needs_stamps=clock.source == "stamp")
    rank = np.arange(log.size)
    if clock.late:
        rank[np.argsort(clock.ns(stamps, log, 0), kind="stable")] = np.arange(log.size)
    return rank


def _miscounted(source: McapLog, topics: dict[int, PatchedTopic]) -> Iterator[int]:
    """Topics some of whose messages were read but cannot be patched (compressed one by one)."""
    counts = dict.fromkeys(topics, 0)
    for block in source.scan(strict=False).blocks():
        channels = block.header("channel").astype(np.int64)
        for number, topic in topics.items():
            part = block.take(channels == number)
            if part.starts.size:
                counts[number] += int(np.all([p != -1 for p in topic.located(part)], axis=0).sum())
    yield from [n for n, topic in topics.items() if counts[n] != topic.rank.size]


@dataclass(frozen=True)
class Contents:
    """Every channel of a file by its number; attachments and metadata as
    (opcode, byte, size) of their content."""

    topics: dict[int, Topic]
    extras: tuple[tuple[int, int, int], ...]


def contents_of(source: McapLog) -> Contents:
    """What there is to copy from a file."""
    scanner = source.scan(strict=False)
    for _ in scanner.blocks():
        pass
    topics = {**source.summary().topics, **scanner.topics}
    return Contents(topics, tuple(scanner.extras))


def copy_extras(source: McapLog, extras: tuple[tuple[int, int, int], ...], file: McapFile) -> None:
    """Copy attachments and metadata records but our own marks, which are written anew; one whose
    CRC or names do not fit is left out."""
    with source.path.open("rb") as stream:
        for opcode, at, size in extras:
            stream.seek(at)
            content = stream.read(size)
            crc = int.from_bytes(content[-4:], "little") if opcode == ATTACHMENT else 0
            if len(content) < size or (crc and crc != zlib.crc32(content[:-4])):
                continue
            try:
                if opcode == METADATA and text_at(content, 0)[0] == CORRECTIONS:
                    continue
                (file.attachment if opcode == ATTACHMENT else file.metadata)(content)
            except MalformedRecordError:
                continue


def copied(source: McapLog, kept: dict[int, Topic], patch: Patch) -> Iterator[ChunkData]:
    """The messages of some channels, a chunk at a time, as they are but for what is patched."""
    numbers = np.zeros(1 << 16, dtype=np.bool_)
    numbers[list(kept)] = True
    for block in source.scan(strict=False).blocks():
        channels = block.header("channel").astype(np.int64)
        patched, lost = patch.apply(block, channels)
        wanted = numbers[channels] & ~lost
        if wanted.any():
            part = patched.take(wanted)
            yield _records_of(part, channels[wanted])


def _records_of(block: MessageBlock, channels: NDArray[np.int64]) -> ChunkData:
    sizes = block.lengths + 31
    starts = np.cumsum(sizes) - sizes
    edges = zip((block.starts - 31).tolist(), (block.starts + block.lengths).tolist(), strict=True)
    data = b"".join([block.data[a:b] for a, b in edges])
    return data, starts, channels, block.header("log_time")


def write_with_topics_of(recording: Recording, source: Path, path: Path) -> None:
    """Write a recording over the MCAP file that it was read from, as a new file.

    Messages of sensor_msgs/Imu get the recording's vectors and keep every other byte, their times
    and sequence numbers (see `patch_of`); other kinds of topics that the recording was read from
    are written anew. All other topics, attachments and metadata are copied; damaged parts of the
    source are left out. Written atomically.
    """
    with replaced_atomically(path) as temporary:
        most = from_dict(recording.mapping).max_chunk
        _write_over(recording, temporary, McapLog(source, most))


def _write_over(recording: Recording, path: Path, source: McapLog) -> None:
    contents, patch = contents_of(source), patch_of(recording, source)
    held = {topic.name for topic in patch.topics.values()}
    replaced = _replaced(recording) - held
    kept = {n: t for n, t in contents.topics.items() if t.name not in replaced}
    left = {n: c for n, c in recording.channels.items() if n not in patch.channels}
    anew = replace(recording, channels=left)
    file = McapFile(path, "ros2", LIBRARY)
    try:
        outputs, base = outputs_beside(
            anew, contents.topics, kept, _names(anew), _log_origin(anew, source)
        )
        file.marks(recording.corrections)
        define(file, outputs, kept, base)
        for chunk in chunks_of(outputs):
            file.chunk(*chunk)
        for block in copied(source, kept, patch):
            file.chunk(*block)
        copy_extras(source, contents.extras, file)
        file.close()
    finally:
        file.abandon()


def _replaced(recording: Recording) -> set[str]:
    names = set()
    for quantity in ("acc", "gyro"):
        stated = recording.mapping.get(quantity, ())
        for text in stated if isinstance(stated, list | tuple) else ():
            names.add(str(text).rpartition(":")[0])
    return names


def _names(recording: Recording) -> dict[str, str]:
    """The topic of each channel: where it was read from, or a new one."""
    names = topic_names(recording)
    triads = recording.mapping.get("triads", ())
    for quantity, short in SHORT_NAMES.items():
        stated = recording.mapping.get(short, ())
        if not isinstance(stated, list | tuple) or not isinstance(triads, list | tuple):
            continue
        for triad, text in zip(triads, stated, strict=False):
            topic, name = str(text).rpartition(":")[0], f"{triad}/{quantity}"
            if topic and name in names and short != "temperature":
                names[name] = topic
    return names


def _log_origin(recording: Recording, source: McapLog) -> int:
    """ns that brings a recording without a date to the log times of the file it joins."""
    if recording.start_ns is not None:
        return 0
    for block in source.scan(strict=False).blocks():
        return int(block.header("log_time").min())
    return 0
