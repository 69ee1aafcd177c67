"""Files that are whole or not there: written beside their place and renamed into it."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from imucalib.errors import UsageError


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
