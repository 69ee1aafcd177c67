"""Recordings as MCAP: sensor_msgs/msg/Imu in CDR, one topic a triad, zstd chunks.

The channel metadata of the file keeps what the message cannot say (the triad's name, its unit
when raw, the time origin), so that the reader gives back the same recording.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import imucalib
from imucalib.atomic_file import replaced_atomically
from imucalib.errors import UsageError
from imucalib.readers.mcap.reader import McapLog
from imucalib.readers.messages.records import Topic
from imucalib.recording.mapping import from_dict
from imucalib.recording.recording import Recording
from imucalib.writers.mcap.copy import (
    contents_of,
    copied,
    copy_extras,
    log_origin,
)
from imucalib.writers.mcap.file import McapFile
from imucalib.writers.mcap.messages import SCHEMAS, Output, chunks_of
from imucalib.writers.mcap.patch import patch_of
from imucalib.writers.mcap.topics import SHORT_NAMES, following, outputs_of

_LIBRARY = f"imucal {imucalib.__version__}"


class McapWriter:
    """The MCAP writer."""

    name = "mcap"
    suffixes = (".mcap",)

    def write(self, recording: Recording, path: Path) -> None:
        """Write all channels; UsageError for one that a sensor_msgs message cannot hold."""
        self.write_blocks([recording], path)

    def write_blocks(self, blocks: Iterable[Recording], path: Path) -> None:
        """Write block after block; memory holds one. Errors as in `write`, and ChannelsChange where
        the topics of the first block do not fit a later one."""
        file = McapFile(path, "ros2", _LIBRARY)
        outputs: list[Output] = []
        try:
            for recording in blocks:
                if outputs:
                    outputs = following(outputs, recording)
                elif recording.channels:
                    outputs, base = _outputs(recording, None, {}, {})
                    file.marks(recording.corrections)
                    _define(file, outputs, {}, base)
                for chunk in chunks_of(outputs):
                    file.chunk(*chunk)
            file.close()
        finally:
            file.abandon()


def write_with_topics_of(recording: Recording, source: Path, path: Path) -> None:
    """Write a recording over the MCAP file that it was read from, as a new file.

    Messages of sensor_msgs/Imu get the recording's vectors and keep every other byte, their times
    and sequence numbers (see `mcap_patch`); other kinds of topics that the recording was read from
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
    file = McapFile(path, "ros2", _LIBRARY)
    try:
        outputs, base = _outputs(anew, source, contents.topics, kept)
        file.marks(recording.corrections)
        _define(file, outputs, kept, base)
        for chunk in chunks_of(outputs):
            file.chunk(*chunk)
        for block in copied(source, kept, patch):
            file.chunk(*block)
        copy_extras(source, contents.extras, file)
        file.close()
    finally:
        file.abandon()


def _outputs(
    recording: Recording, source: McapLog | None, topics: dict[int, Topic], kept: dict[int, Topic]
) -> tuple[list[Output], int]:
    """The topics that are written anew, and the highest schema number of the source."""
    taken = _topic_names(recording, source is not None)
    clashes = {t.name for t in kept.values()} & set(taken.values())
    if clashes:
        raise UsageError(f"the source has topics of the same name: {', '.join(sorted(clashes))}")
    first = max([0, *topics]) + 1
    outputs = outputs_of(recording, taken, first, log_origin(recording, source))
    base = max([0, *(t.schema.id for t in topics.values() if t.schema)])
    if first + len(outputs) > 65535 or base + len(SCHEMAS) > 65535:
        raise UsageError(
            "the source has no free channel numbers left",
            where=str(source.path) if source else recording.path,
        )
    return outputs, base


def _define(file: McapFile, outputs: list[Output], kept: dict[int, Topic], base: int) -> None:
    for topic in kept.values():
        if topic.schema:
            file.schema(*topic.schema)
    for number in sorted({output.schema for output in outputs}):
        name, text = SCHEMAS[number]
        file.schema(base + number, name, "ros2msg", text.encode())
    for number, topic in kept.items():
        schema = topic.schema.id if topic.schema else 0
        file.channel(number, schema, topic.name, topic.encoding, dict(topic.metadata))
    for output in outputs:
        file.channel(output.number, base + output.schema, output.topic, "cdr", output.metadata)


def _replaced(recording: Recording) -> set[str]:
    names = set()
    for quantity in ("acc", "gyro"):
        stated = recording.mapping.get(quantity, ())
        for text in stated if isinstance(stated, list | tuple) else ():
            names.add(str(text).rpartition(":")[0])
    return names


def _topic_names(recording: Recording, replace: bool) -> dict[str, str]:
    """The topic of each channel: the source's own where it is replaced, else "/<triad>/..."."""
    names = {}
    for name, channel in recording.channels.items():
        ending = "temperature" if channel.quantity == "temperature" else "imu"
        ending = "accel" if channel.quantity.startswith("angular_acceleration") else ending
        names[name] = f"/{channel.triad}/{ending}"
    if not replace:
        return names
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


WRITER = McapWriter()
