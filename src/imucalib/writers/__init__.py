"""Recording formats for output: each module of this folder that has a `WRITER` writes one.

A writer is found by its file being here and chosen by the suffix of the output path.
"""

from __future__ import annotations

import importlib
import os
import pkgutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Protocol, runtime_checkable

from imucalib.errors import UsageError
from imucalib.readers.joining import join
from imucalib.recording import Recording

__all__ = [
    "BlockWriter",
    "Writer",
    "replaced_atomically",
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


@cache
def writers() -> tuple[Writer, ...]:
    """Every writer of this folder, in the order of their module names."""
    names = sorted(m.name for m in pkgutil.iter_modules(__path__))
    modules = (importlib.import_module(f"{__name__}.{name}") for name in names)
    return tuple(m.WRITER for m in modules if hasattr(m, "WRITER"))


def writer_for(path: str | os.PathLike[str]) -> Writer:
    """The writer that the suffix of `path` selects; UsageError when there is none."""
    for writer in writers():
        if Path(path).name.lower().endswith(writer.suffixes):
            return writer
    known = ", ".join(s for w in writers() for s in w.suffixes)
    raise UsageError("no writer for this suffix", where=str(path), remedy=f"use one of: {known}")


@contextmanager
def replaced_atomically(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary path in the same folder, renamed to `path` when the block ends without error.

    A reader of `path` sees the old file or the whole new one, at every moment. Raises UsageError
    when the folder is missing or not writable.
    """
    target = Path(path)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{target.name}.", suffix=".tmp", dir=target.parent)
        os.close(handle)
    except OSError as error:
        raise UsageError(
            f"the output cannot be written: {error.strerror}", where=str(path)
        ) from error
    temporary = Path(name)
    try:
        yield temporary
        _fill_permissions(temporary)
        os.replace(temporary, target)
    except OSError as error:
        raise UsageError(f"the output cannot be written: {error}", where=str(path)) from error
    finally:
        temporary.unlink(missing_ok=True)


def _fill_permissions(path: Path) -> None:
    # mkstemp makes files private (0600); an output has the permissions of any new file.
    mask = os.umask(0)
    os.umask(mask)
    path.chmod(0o666 & ~mask)


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
