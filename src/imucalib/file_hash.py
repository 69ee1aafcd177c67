"""SHA-256 of files: what an input is known by, in calibrations, certificates and catalogues."""

from __future__ import annotations

import hashlib
import os
import time
from functools import lru_cache

from imucalib.errors import UnreadableInput

#: ns, well beyond what file systems tell apart.
_TICK_NS = 3 * 10**9


def sha256_of(path: str | os.PathLike[str]) -> str:
    """SHA-256 of the file's bytes as lower-case hex; of a file that has not changed, once."""
    try:
        seen = os.stat(path)
        state = (seen.st_dev, seen.st_ino, seen.st_size, seen.st_mtime_ns, seen.st_ctime_ns)
        # Two states within one tick of the file system's clock look the same.
        settled = time.time_ns() - max(state[-2:]) > _TICK_NS
        digest = _digest if settled else _digest.__wrapped__
        return digest(os.path.abspath(path), state)
    except OSError as error:
        raise UnreadableInput(
            f"the file cannot be read: {error.strerror}", where=str(path)
        ) from error


@lru_cache(maxsize=64)
def _digest(path: str, state: tuple[int, ...]) -> str:
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
