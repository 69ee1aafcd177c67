"""Topics, attachments and metadata of another MCAP file, copied untouched."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib.readers.mcap.reader import McapLog
from imucalib.readers.messages.records import (
    ATTACHMENT,
    CORRECTIONS,
    METADATA,
    MalformedRecordError,
    MessageBlock,
    Topic,
    text_at,
)
from imucalib.recording.recording import Recording
from imucalib.writers.mcap.file import McapFile
from imucalib.writers.mcap.messages import ChunkData
from imucalib.writers.mcap.patch import Patch


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


def log_origin(recording: Recording, source: McapLog | None) -> int:
    """ns that brings a recording without a date to the log times of the file it joins."""
    if recording.start_ns is not None or source is None:
        return 0
    for block in source.scan(strict=False).blocks():
        return int(block.header("log_time").min())
    return 0


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
