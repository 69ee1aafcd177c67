"""Topics of another MCAP file, copied untouched."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucalib.readers.mcap_records import MessageBlock, Topic
from imucalib.readers.mcap_scan import Scanner
from imucalib.readers.mcap_summary import read_summary
from imucalib.recording import Recording
from imucalib.writers.mcap_messages import ChunkData


def topics_of(source: Path) -> dict[int, Topic]:
    """Every channel of a file by its number."""
    scanner = Scanner(source)
    for _ in scanner.blocks():
        pass
    return {**read_summary(source).topics, **scanner.topics}


def log_origin(recording: Recording, source: Path | None) -> int:
    """ns that brings a recording without a date to the log times of the file it joins."""
    if recording.start_ns is not None or source is None:
        return 0
    for block in Scanner(source).blocks():
        return int(block.header("log_time").min())
    return 0


def copied(source: Path, kept: dict[int, Topic]) -> Iterator[ChunkData]:
    """The messages of some channels, a chunk at a time, as they are."""
    numbers = np.zeros(1 << 16, dtype=np.bool_)
    numbers[list(kept)] = True
    for block in Scanner(source).blocks():
        channels = block.header("channel").astype(np.int64)
        wanted = numbers[channels]
        if wanted.any():
            part = block.take(wanted)
            yield _records_of(part, channels[wanted])


def _records_of(block: MessageBlock, channels: NDArray[np.int64]) -> ChunkData:
    sizes = block.lengths + 31
    starts = np.cumsum(sizes) - sizes
    edges = zip((block.starts - 31).tolist(), (block.starts + block.lengths).tolist(), strict=True)
    data = b"".join([block.data[a:b] for a, b in edges])
    return data, starts, channels, block.header("log_time")
