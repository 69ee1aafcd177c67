"""Recording formats for output: each module of this folder that has a `WRITER` writes one.

A writer is found by its file being here and chosen by the suffix of the output path.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Protocol

from imucalib.atomic_file import replace_atomically
from imucalib.core.discovery import modules_of
from imucalib.errors import UsageError
from imucalib.recording.recording import Recording

__all__ = ["ChannelsChange", "Noted", "Writer", "write", "write_blocks", "writer_for", "writers"]


class Writer(Protocol):
    """One output format; its memory is bounded by a block."""

    @property
    def name(self) -> str:
        """Short name of the format, equal to the name of the reader that reads it back."""
        ...

    @property
    def suffixes(self) -> tuple[str, ...]:
        """Lower-case file name endings that select this writer, with the dot."""
        ...

    def write_blocks(self, blocks: Iterable[Recording], path: Path) -> None:
        """Write blocks, as `readers.blocks` yields them, so that the reader of the same name gives
        all channels back bit for bit.

        path : a temporary file that is renamed when complete
        """
        ...


class ChannelsChange(UsageError):
    """A block has channels that the format had to know from the first on. where : the recording"""

    def __init__(self, channels: str, where: str) -> None:
        what = f"channels change within the recording: {channels}"
        super().__init__(what, where=where, remedy="write HDF5 (.h5) instead")


class Noted:
    """Blocks on their way to a writer; notes, channels : of those that passed, each once."""

    def __init__(self, blocks: Iterable[Recording]) -> None:
        self._blocks = blocks
        self.notes, self.channels = dict[str, None](), dict[str, None]()

    def __iter__(self) -> Iterator[Recording]:
        where = ""
        for block in self._blocks:
            where = block.path
            self.notes.update(dict.fromkeys(block.notes))
            self.channels.update(dict.fromkeys(block.channels))
            yield block
        if not self.channels:
            raise UsageError("the recording has no channels to write", where=where)


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
    """Write a recording in the format of the suffix; errors as in `write_blocks`."""
    write_blocks([recording], path)


def write_blocks(blocks: Iterable[Recording], path: str | os.PathLike[str]) -> None:
    """Write a recording that comes in blocks, in the format of the suffix; the old file stays whole
    until the end.

    Raises UsageError for an unknown suffix, an unwritable place, a recording without channels and
    what the format cannot hold, ChannelsChange where a format must know all channels first.
    """
    writer = writer_for(path)
    with replace_atomically(path) as temporary:
        writer.write_blocks(Noted(blocks), temporary)
