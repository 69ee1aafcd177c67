"""The input file before any format is known: can it be opened at all, and what is its hash."""

from __future__ import annotations

import hashlib
import os
import stat
from pathlib import Path

from imucalib.errors import UnreadableInput

HEAD_BYTES = 65536  #: what `recognises` gets to see
#: Bytes within which a zip archive's end record lies (22 and a comment of 64 KiB), and of its
#: directory: some 10,000 files.
_ARCHIVE_END, _MOST_DIRECTORY = 22 + (1 << 16), 1 << 20


def head_of(path: Path) -> bytes:
    """The first HEAD_BYTES of a regular, non-empty, readable file; UnreadableInput otherwise."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError) as error:
        detail = getattr(error, "strerror", None) or str(error)
        raise UnreadableInput(
            f"the file cannot be opened: {detail}", where=str(path), remedy="check the path"
        ) from error
    if stat.S_ISDIR(mode):
        inside = sorted(p for p in path.iterdir() if p.is_file() and p.name[0] != ".")
        names = f"name one file, such as {inside[0]}" if inside else "it holds no file"
        raise UnreadableInput(
            "this is a directory",
            where=str(path),
            remedy=f"{names}; a folder of recordings goes to imucal batch",
        )
    if not stat.S_ISREG(mode):
        raise UnreadableInput(
            "this is not a regular file (a pipe, socket or device)",
            where=str(path),
            remedy="save the stream to a file first",
        )
    try:
        with path.open("rb") as stream:
            head = stream.read(HEAD_BYTES)
    except OSError as error:
        raise UnreadableInput(
            f"the file cannot be read: {error.strerror}",
            where=str(path),
            remedy="check its permissions",
        ) from error
    if not head:
        raise UnreadableInput(
            "the file is empty (0 bytes)", where=str(path), remedy="copy it again from its source"
        )
    return head


def small_directory(path: Path) -> bool:
    """Whether a zip archive's directory, which is held in memory, is that of some files: a hundred
    million names make a bomb of it. False also where there is none."""
    with path.open("rb") as stream:
        stream.seek(max(0, stream.seek(0, os.SEEK_END) - _ARCHIVE_END))
        tail = stream.read()
    at = tail.rfind(b"PK\x05\x06")
    return at >= 0 and int.from_bytes(tail[at + 12 : at + 16], "little") <= _MOST_DIRECTORY


def sha256_of(path: str | os.PathLike[str]) -> str:
    """SHA-256 of the file's bytes as lower-case hex, read in pieces of 1 MiB."""
    try:
        with Path(path).open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise UnreadableInput(
            f"the file cannot be read: {error.strerror}", where=str(path)
        ) from error
