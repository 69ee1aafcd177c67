"""MATLAB files up to version 7 (.mat), through scipy; version 7.3 is HDF5 and read as such.

Such a file is compressed variable by variable, so all of it is held in memory; what is found in it
is what would be found in an HDF5 file with the same names.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from imucalib.errors import ImucalError, UnreadableInput
from imucalib.readers.hdf5.reader import Held, HeldReader

_START = b"MATLAB 5.0 MAT-file"
_MOST_BYTES, _MOST_RATIO, _DEEPEST = 4 << 30, 200, 8  # packed better than this is no recording


class MatlabReader(HeldReader):
    """Reader of MATLAB files; see `imucalib.readers.Reader`."""

    name = "matlab"
    suffixes = (".mat",)

    def recognises(self, path: Path, head: bytes) -> bool:
        """The text that every file of version 5 to 7 begins with."""
        return head.startswith(_START)

    def fill(self, held: Any, path: Path, *, strict: bool) -> Held:
        """Put the numbers in; nothing is known to be lost of a file that can be read."""
        _store(held, _variables(path), 0)
        return Held()


READER = MatlabReader()


def _variables(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat, whosmat

    try:
        claimed = sum(8 * int(np.prod(shape, dtype=object)) for _, shape, _ in whosmat(path))
        if claimed > min(_MOST_BYTES, _MOST_RATIO * max(path.stat().st_size, 1 << 16)):
            what = f"the variables claim {claimed} bytes in a file of {path.stat().st_size}"
            raise UnreadableInput(what, where=str(path))
        found: dict[str, Any] = loadmat(path, struct_as_record=True, chars_as_strings=True)
    except ImucalError:
        raise
    except Exception as error:  # what scipy raises on damage depends on where the damage is
        raise UnreadableInput(
            f"the MATLAB file cannot be read: {error}",
            where=str(path),
            remedy="it may be cut: save it again, with -v7.3 if it is large",
        ) from error
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _store(group: Any, variables: dict[str, Any], depth: int) -> None:
    """Numbers as datasets, structs as groups; text, cells and objects are passed over."""
    for name, value in variables.items():
        if not isinstance(value, np.ndarray) or not value.size or "/" in name or not name:
            continue
        if value.dtype.names and value.size == 1 and depth < _DEEPEST:
            fields = value.reshape(-1)[0]
            _store(group.create_group(name), {n: fields[n] for n in value.dtype.names}, depth + 1)
        elif value.dtype.kind in "iuf":
            column = value.ndim == 2 and 1 in value.shape and value.size > 1
            group.create_dataset(name, data=value.reshape(-1) if column else value)
            if value.size == 1:
                group.attrs[name] = float(value.reshape(-1)[0])  # as in `fs = 100`
