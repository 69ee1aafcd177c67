"""Recordings in MCAP: ROS 2, ROS 1, JSON and protobuf messages.

Every topic of type sensor_msgs/Imu becomes a triad; without any, topics whose field names tell of
an acceleration do. Split accelerometer and gyroscope topics are joined into one triad.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from imucalib.readers.mcap.scan import Scanner
from imucalib.readers.messages.recording import log_blocks, read_log
from imucalib.readers.messages.records import MAGIC
from imucalib.readers.messages.summary import Summary, read_summary
from imucalib.readers.source import sha256_of
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Recording


@dataclass(frozen=True)
class McapLog:
    """An MCAP file as a log of messages."""

    path: Path
    max_chunk: int | None = None
    format: str = "mcap"

    def scan(self, *, strict: bool) -> Scanner:
        """A linear scan that needs no index."""
        return Scanner(self.path, strict=strict, max_chunk=self.max_chunk)

    def summary(self) -> Summary:
        """What the file's own summary says; empty when it is absent or damaged."""
        return read_summary(self.path)

    def sha256(self) -> str:
        """Hash of the file."""
        return sha256_of(self.path)


class McapReader:
    """The MCAP reader."""

    name = "mcap"
    suffixes = (".mcap",)

    def recognises(self, path: Path, head: bytes) -> bool:
        """Whether the file begins with the MCAP magic."""
        return head.startswith(MAGIC)

    def read(self, path: Path, mapping: FieldMapping, *, strict: bool) -> Recording:
        """Read all samples in one pass."""
        return read_log(McapLog(path, mapping.max_chunk), mapping, strict=strict)

    def blocks(
        self, path: Path, mapping: FieldMapping, *, block_samples: int, strict: bool
    ) -> Iterator[Recording]:
        """Read the file twice, in bounded memory."""
        log = McapLog(path, mapping.max_chunk)
        yield from log_blocks(log, mapping, block_samples=block_samples, strict=strict)


READER = McapReader()
