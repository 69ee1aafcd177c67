"""A recording over the log of messages that it was read from: vectors patched in, the rest copied.

A message is patched where its acceleration and angular rate are runs of doubles in SI units (what
sensor_msgs/Imu is), and keeps every other byte; topics of other kinds are written anew.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mcap import records as mr
from mcap.opcode import Opcode
from numpy.typing import NDArray

from imucalib.arrays import Array, Flags, Index
from imucalib.atomic_file import replace_atomically
from imucalib.errors import UsageError
from imucalib.readers import reader_for
from imucalib.readers.fields.choice import OPTIONS
from imucalib.readers.mcap import CORRECTIONS, MalformedRecordError, parse_record
from imucalib.readers.messages.decode import RosDecoder, decoder_for
from imucalib.readers.messages.layout import Groups
from imucalib.readers.messages.recording import ChannelPlan, FirstPass, LogReader
from imucalib.readers.messages.records import MESSAGE_HEAD, MessageBlock, MessageLog, Topic
from imucalib.recording.mapping import UNCHANGED, from_dict
from imucalib.recording.recording import Recording
from imucalib.writers.mcap import (
    MESSAGES,
    McapFile,
    define_outputs,
    outputs_of,
    put_block,
    topic_names,
)

_SI = {"acceleration": "m/s2", "angular_rate": "rad/s"}


@dataclass
class _Patched:
    """One topic whose messages are kept and whose vectors are replaced.

    number : of its channel; groups, values : of each vector, its place in a message and its new
    values (n, 3); rows : (n,) the recording's row of each message in file order; done : messages
    that were passed
    """

    name: str
    number: int
    decoder: RosDecoder
    groups: Groups
    values: list[Array]
    rows: Index
    done: int = 0

    def patch(self, block: MessageBlock, data: NDArray[np.uint8] | None) -> Flags:
        """Replace the vectors of its messages in `data`, the bytes of the block, where given.

        Returns which of the messages have them as runs of doubles.
        """
        found = [
            (rows, runs)
            for rows, family, _ in self.decoder.fitting(block, self.groups, [])
            if (runs := family.runs()) is not None
        ]
        known = np.zeros(block.starts.size, dtype=np.bool_)
        for rows, _ in found:
            known[rows] = True
        new = self.done + np.cumsum(known) - 1
        self.done += int(known.sum())
        for rows, runs in found if data is not None else ():
            for (offset, order), values in zip(runs, self.values, strict=True):
                raw = np.ascontiguousarray(values[self.rows[new[rows]]], dtype=f"{order}f8")
                places = (block.starts[rows] + offset)[:, None] + np.arange(8 * 3)
                data[places] = raw.view(np.uint8)  # type: ignore[index]
        return known


def write_with_topics_of(recording: Recording, source: Path, path: Path) -> None:
    """Write a recording over the MCAP file or ROS bag that it was read from, as a new MCAP file.

    Messages of sensor_msgs/Imu get the recording's vectors and keep every other byte, their times
    and sequence numbers; other kinds of topics that the recording was read from are written anew.
    All other topics, attachments and metadata are copied; damaged parts of the source are left out.
    Written atomically.
    """
    mapping = from_dict(recording.mapping, "mapping of the recording")
    reader = reader_for(source)
    assert isinstance(reader, LogReader)
    log = reader.open(source, mapping)
    first = FirstPass(log, mapping, keep=True)
    topics, extras = first.stream.topics, getattr(log, "extras", [])
    patched = _find_patches(recording, first)
    first_ns = _exclude_unpatchable(log, patched)
    names = {topic.name for topic in patched}
    stated = {str(text).rpartition(":")[0] for text in (*mapping.acc, *mapping.gyro)}
    kept = {n: topic for n, topic in topics.items() if topic.name not in stated - names}
    # A thermometer's topic is never changed: it is copied like any other.
    held = {p.name for p in first.plan.parts if p.topic in names or p.channel.unit == "degC"}
    anew = replace(
        recording, channels={n: c for n, c in recording.channels.items() if n not in held}
    )
    origin = first_ns if recording.start_ns is None else 0
    with replace_atomically(path) as temporary, McapFile(temporary) as file:
        outputs = outputs_of(anew, _names(anew), max([0, *topics]) + 1)
        clashes = {topic.name for topic in kept.values()} & {output.topic for output in outputs}
        if clashes:
            what = f"the source has topics of the same name: {', '.join(sorted(clashes))}"
            raise UsageError(what)
        base = max([0, *(t.schema.id for t in topics.values() if t.schema)])
        if max([0, *topics]) + len(outputs) > 65534 or base + len(MESSAGES) > 65535:
            raise UsageError("the source has no free channel numbers left", where=recording.path)
        file.marks(recording.corrections)
        _define_kept(file, kept)
        define_outputs(file, outputs, base)
        put_block(file, outputs, anew, origin)
        _copy(file, log, kept, patched)
        if extras:
            _copy_extras(file, source, extras)


def _find_patches(recording: Recording, first: FirstPass) -> list[_Patched]:
    """The topics whose vectors can be patched into the messages that they were read from."""
    found = []
    for name in first.plan.clocks:
        numbers = [n for n in first.stream.counts if first.stream.topics[n].name == name]
        parts = [p for p in first.plan.parts if p.topic == name and p.channel.quantity in _SI]
        source = first.stream.sources[name]
        if len(numbers) != 1 or not parts or not all(_in_place(p, recording) for p in parts):
            continue
        if source.moved:  # its samples are in another order than its messages
            continue
        decoder = decoder_for(first.stream.topics[numbers[0]])
        values = [recording.channels[part.name].values for part in parts]
        if isinstance(decoder, RosDecoder) and {len(v) for v in values} == {source.rows}:
            groups = tuple(source.fields[part.column].group for part in parts)
            rows = _rows(first, name)
            found.append(_Patched(name, numbers[0], decoder, groups, values, rows))
    return found


def _in_place(part: ChannelPlan, recording: Recording) -> bool:
    """Whether the channel's values are the message's own: SI, no offset, no turned axes."""
    channel, conversion = recording.channels.get(part.name), part.conversion
    plain = conversion.axes == UNCHANGED and not conversion.offset.any()
    same = channel is not None and channel.quantity == part.channel.quantity
    si = conversion.source_unit == _SI[part.channel.quantity] == (channel.unit if channel else "")
    return same and plain and si


def _rows(first: FirstPass, topic: str) -> Index:
    """(n,) for each message in file order its row in the recording, which is in order of time."""
    samples, line = first.samples(topic), first.plan.timelines()[topic]
    numbers = np.arange(samples.log.size)
    line.push(samples._replace(columns=[numbers.astype(np.float64)]))
    line.finish()
    rows = np.empty(numbers.size, dtype=np.intp)
    rows[np.concatenate([columns[0] for columns in line.columns]).astype(np.intp)] = numbers
    return rows


def _exclude_unpatchable(log: MessageLog, patched: list[_Patched]) -> int:
    """Take out topics some of whose messages were read but cannot be patched (compressed one by
    one); returns the first log time, ns."""
    first_ns = 0
    for k, block in enumerate(log.blocks()):
        first_ns = first_ns if k else int(block.header("log_time").min())
        channels = block.header("channel")
        for topic in patched:
            topic.patch(block.take(channels == topic.number), None)
    patched[:] = [topic for topic in patched if topic.done == topic.rows.size]
    for topic in patched:
        topic.done = 0
    return first_ns


def _names(recording: Recording) -> dict[str, str]:
    """The topic of each channel: where it was read from, or a new one."""
    names = topic_names(recording)
    mapping = from_dict(recording.mapping)
    for quantity in _SI:
        texts = getattr(mapping, OPTIONS[quantity])
        for triad, text in zip(mapping.triads, texts, strict=False):
            topic, name = str(text).rpartition(":")[0], f"{triad}/{quantity}"
            if topic and name in names:
                names[name] = topic
    return names


def _define_kept(file: McapFile, kept: dict[int, Topic]) -> None:
    schemas = {topic.schema.id: topic.schema for topic in kept.values() if topic.schema}
    for schema in schemas.values():
        data = schema.data
        if schema.encoding in ("ros1msg", "ros2msg"):
            # As other readers split it: at lines of 80 signs of equality (MCAP specification,
            # appendix "ros1msg" and "ros2msg").
            data = re.sub(rb"^={3,}(?=\r?$)", b"=" * 80, data, flags=re.MULTILINE)
        file.define(replace(schema, data=data))
    for number, topic in kept.items():
        schema_id = topic.schema.id if topic.schema else 0
        name = topic.name.removesuffix(f"#{number}")  # of a publisher beside another one
        file.define(mr.Channel(number, name, topic.encoding, dict(topic.metadata), schema_id))


def _copy(file: McapFile, log: MessageLog, kept: Iterable[int], patched: list[_Patched]) -> None:
    """The messages of some channels, as they are but for what is patched."""
    wanted = np.zeros(1 << 16, dtype=np.bool_)
    wanted[list(kept)] = True
    for block in log.blocks():
        channels = block.header("channel")
        copied, data = wanted[channels], np.frombuffer(bytearray(block.data), dtype=np.uint8)
        for topic in patched:
            rows = np.flatnonzero(channels == topic.number)
            copied[rows] = topic.patch(block.take(rows), data)
        part = block._replace(data=data.tobytes()).take(copied)
        file.chunk(list(_records(part)), channels[copied], part.header("log_time"))


def _records(block: MessageBlock) -> Iterator[bytes]:
    ends = (block.starts + block.lengths).tolist()
    for start, end in zip((block.starts - MESSAGE_HEAD).tolist(), ends, strict=True):
        yield block.data[start:end]


def _copy_extras(file: McapFile, source: Path, extras: list[tuple[int, int, int]]) -> None:
    """Attachments and metadata but our own marks, which are written anew; one whose CRC or names do
    not fit is left out."""
    with source.open("rb") as stream:
        for opcode, at, size in extras:
            stream.seek(at)
            content = stream.read(size)
            try:
                if opcode == Opcode.METADATA:
                    record = parse_record(mr.Metadata, content)
                    if record.name != CORRECTIONS:
                        file.metadata(record)
                    continue
                crc = int.from_bytes(content[-4:], "little")
                if len(content) == size and crc in (0, zlib.crc32(content[:-4])):
                    file.attachment(parse_record(mr.Attachment, content))
            except MalformedRecordError:
                continue
