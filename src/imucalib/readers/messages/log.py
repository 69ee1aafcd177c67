"""A log of messages by topic, whatever file it is in: what MCAP and ROS bags have in common."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from imucalib.readers.messages.records import Damage, MessageBlock, Topic
from imucalib.readers.messages.summary import Summary
from imucalib.recording.correction import Correction


class Scan(Protocol):
    """One pass over a log: `topics` (by channel number), `damages` and `corrections` fill
    meanwhile."""

    topics: dict[int, Topic]
    damages: list[Damage]
    corrections: tuple[Correction, ...]

    def blocks(self) -> Iterator[MessageBlock]:
        """The messages in file order, some thousand at a time."""
        ...


class MessageLog(Protocol):
    """A file, or a folder of files, that holds messages."""

    @property
    def format(self) -> str:
        """Name of the reader, stored in `Recording.format`."""
        ...

    @property
    def path(self) -> Path:
        """The file or folder."""
        ...

    def scan(self, *, strict: bool) -> Scan:
        """Begin a pass; with `strict` the first damage raises UnreadableInput."""
        ...

    def summary(self) -> Summary:
        """Topics and counts that are known without a pass; nothing depends on them."""
        ...

    def sha256(self) -> str:
        """SHA-256 of the content as lower-case hex."""
        ...
