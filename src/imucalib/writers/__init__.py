"""Recording formats for output: each module of this folder that has a `WRITER` writes one.

A writer is found by its file being here and chosen by the suffix of the output path.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Protocol, runtime_checkable

from imucalib.atomic_file import replaced_atomically
from imucalib.core.discovery import modules_of
from imucalib.errors import UsageError
from imucalib.readers.joining import join
from imucalib.recording.recording import Recording

__all__ = [
    "BlockWriter",
    "ChannelsChange",
    "Told",
    "Writer",
    "write",
    "write_blocks",
    "writer_for",
    "writers",
]


class Writer(Protocol):
    """One output format. `write` fills `path`, a temporary file that is renamed when complete."""

    @property
    def name(self) -> str:
        """Short name of the format, equal to the name of the reader that reads it back."""
        ...

    @property
    def suffixes(self) -> tuple[str, ...]:
        """Lower-case file name endings that select this writer, with the dot."""
        ...

    def write(self, recording: Recording, path: Path) -> None:
        """Write all channels so that the reader of the same name gives them back bit for bit."""
        ...


@runtime_checkable
class BlockWriter(Protocol):
    """A writer whose memory is bounded by a block."""

    def write_blocks(self, blocks: Iterable[Recording], path: Path) -> None:
        """Write blocks as `readers.blocks` yields them."""
        ...


class ChannelsChange(UsageError):
    """A block has channels that the format had to know from the first on."""


class Told:
    """Blocks on their way to a writer, and what they told: their notes and channels, each once."""

    def __init__(self, blocks: Iterable[Recording]) -> None:
        self._blocks = blocks
        self.notes, self.channels = dict[str, None](), dict[str, None]()

    def __iter__(self) -> Iterator[Recording]:
        for block in self._blocks:
            self.notes.update(dict.fromkeys(block.notes))
            self.channels.update(dict.fromkeys(block.channels))
            yield block
        if not self.channels:
            raise UsageError("the recording has no channels to write")


@cache
def writers() -> tuple[Writer, ...]:
    """Every writer of this folder, in the order of their module names."""
    return tuple(m.WRITER for m in modules_of(__name__) if hasattr(m, "WRITER"))


def writer_for(path: str | os.PathLike[str]) -> Writer:
    """The writer that the suffix of `path` selects; UsageError when there is none."""
    for writer in writers():
        if Path(path).name.lower().endswith(writer.suffixes):
            return writer
    known = ", ".join(s for w in writers() for s in w.suffixes)
    raise UsageError("no writer for this suffix", where=str(path), remedy=f"use one of: {known}")


def write(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write a recording in the format of the suffix; the old file stays whole until the end.

    Raises UsageError for an unknown suffix, an unwritable place or a recording without channels.
    """
    writer = writer_for(path)
    if not recording.channels:
        raise UsageError("the recording has no channels to write", where=recording.path)
    with replaced_atomically(path) as temporary:
        writer.write(recording, temporary)


def write_blocks(blocks: Iterable[Recording], path: str | os.PathLike[str]) -> None:
    """Write a recording that comes in blocks, in the format of the suffix; errors as in `write`.

    A format that cannot grow block by block takes the whole recording into memory.
    """
    writer = writer_for(path)
    with replaced_atomically(path) as temporary:
        if isinstance(writer, BlockWriter):
            writer.write_blocks(blocks, temporary)
        else:
            writer.write(join(blocks, str(path)), temporary)
