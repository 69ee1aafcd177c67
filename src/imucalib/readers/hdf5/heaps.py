"""Heaps of texts in an HDF5 file: a damaged one can keep the C library in a loop for ever.

The library walks a heap from object to object by their sizes; one whose size is nothing leads it
nowhere, and no signal ends that. So heaps are walked here first. Layout: HDF5 File Format
Specification, III.E, "Global Heap".
"""

from __future__ import annotations

import struct
from pathlib import Path

from imucalib.errors import UnreadableInput

_MARK, _SIZE = b"GCOL\x01\0\0\0", struct.Struct("<Q")
_OBJECT = struct.Struct("<HHIQ")  # number (0: free space), uses, nothing, size
#: Bytes searched at each end of a file: where writers put what they write before and after data.
_SPAN, _PIECE = 32 << 20, 4 << 20  # and how many are held at a time
_LARGEST = 1 << 20  # of a heap; the library makes them of 4 KiB, or as large as one text needs


def demand_ends(path: Path) -> None:
    """Raise UnreadableInput for a heap whose walk would not end."""
    size = path.stat().st_size
    spans = ((0, min(_SPAN, size)), (max(_SPAN, size - _SPAN), size))
    with path.open("rb") as file:
        for first, last in spans:
            for start in range(first, last, _PIECE):
                file.seek(start)
                _demand_ends_in(file.read(_PIECE + _LARGEST), start, path)


def _demand_ends_in(data: bytes, start: int, path: Path) -> None:
    """Of the heaps that begin in the first piece of some bytes; what follows lets them end."""
    at = data.find(_MARK, 0, _PIECE + len(_MARK) - 1)
    while at >= 0:
        if not _ends(data, at):
            raise UnreadableInput(
                "a heap of texts is damaged",
                where=f"{path}, byte {start + at}",
                remedy="copy it again from its source",
            )
        at = data.find(_MARK, at + 1, _PIECE + len(_MARK) - 1)


def _ends(data: bytes, start: int) -> bool:
    if start + 16 > len(data):
        return True
    (size,) = _SIZE.unpack_from(data, start + 8)
    at, stop = start + 16, min(start + min(size, _LARGEST), len(data))
    while at + _OBJECT.size <= stop:
        number, _, _, length = _OBJECT.unpack_from(data, at)
        # As the library counts: an object is filled up to eight bytes, in 64 bits.
        step = (_OBJECT.size + (length + 7 & ~7) if number else length) % (1 << 64)
        if step == 0:
            return False
        at += step
    return True
