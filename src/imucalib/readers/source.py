"""The input file before any format is known: can it be opened at all, and what is its hash."""

from __future__ import annotations

import hashlib
import os
import stat
from pathlib import Path

from imucalib.errors import UnreadableInput

HEAD_BYTES = 65536  #: what `recognises` gets to see


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
        raise UnreadableInput(
            "this is a directory", where=str(path), remedy="name one recording file inside it"
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


def sha256_of(path: str | os.PathLike[str]) -> str:
    """SHA-256 of the file's bytes as lower-case hex, read in pieces of 1 MiB."""
    try:
        with Path(path).open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise UnreadableInput(
            f"the file cannot be read: {error.strerror}", where=str(path)
        ) from error
