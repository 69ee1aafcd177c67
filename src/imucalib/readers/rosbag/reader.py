"""Recordings in ROS bags: ROS 1 .bag, ROS 2 .db3 and bag folders, through the package rosbags.

rosbags unpacks the containers; messages are decoded by the layouts that MCAP files use.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from imucalib.readers.messages.recording import log_blocks, read_log
from imucalib.readers.messages.summary import Summary
from imucalib.readers.rosbag.scan import SQLITE, BagScan
from imucalib.readers.source import sha256_of
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Recording

_ROS1 = b"#ROSBAG V"


@dataclass(frozen=True)
class BagLog:
    """A bag file or folder as a log of messages."""

    path: Path
    format: str = "rosbag"

    def scan(self, *, strict: bool) -> BagScan:
        """A pass in order of time, as the bag's index gives it."""
        return BagScan(self.path, strict=strict)

    def summary(self) -> Summary:
        """Topics and their counts, from the bag's index."""
        return BagScan(self.path, strict=False).summary()

    def sha256(self) -> str:
        """Hash of the file; of a folder, the hash over its files' names and hashes, in order."""
        if not self.path.is_dir():
            return sha256_of(self.path)
        files = sorted(p for p in self.path.iterdir() if p.is_file())
        whole = hashlib.sha256()
        for file in files:
            whole.update(f"{sha256_of(file)}  {file.name}\n".encode())
        return whole.hexdigest()


class RosbagReader:
    """The reader of ROS bags; needs the extra `ros`."""

    name = "rosbag"
    suffixes = (".bag", ".db3")

    def recognises(self, path: Path, head: bytes) -> bool:
        """A ROS 1 bag, a ROS 2 database, or a folder with a metadata.yaml."""
        folder = not head and path.is_dir()
        database = head.startswith(SQLITE) and path.suffix.lower() == ".db3"
        return folder or database or head.startswith(_ROS1)

    def read(self, path: Path, mapping: FieldMapping, *, strict: bool) -> Recording:
        """Read all samples in one pass."""
        return read_log(BagLog(path), mapping, strict=strict)

    def blocks(
        self, path: Path, mapping: FieldMapping, *, block_samples: int, strict: bool
    ) -> Iterator[Recording]:
        """Read the bag twice, in bounded memory."""
        yield from log_blocks(BagLog(path), mapping, block_samples=block_samples, strict=strict)


READER = RosbagReader()
