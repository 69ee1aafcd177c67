"""The records inside a chunk: runs of equal-length messages found as whole arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucalib.readers.messages.records import (
    CHANNEL,
    MESSAGE,
    MESSAGE_HEADER_SIZE,
    RECORD_HEADER,
    SCHEMA,
)

_RUN_START = 8  # equal lengths in a row before a whole run is looked for


class Walk(NamedTuple):
    """What `walk` found: message records, other records (opcode, start, stop), and the end."""

    starts: NDArray[np.int64]
    others: list[tuple[int, int, int]]
    end: int
    stopped: str  # why the walk ended before the last byte, or ""


def walk(data: bytes) -> Walk:
    """Find the records in a chunk's bytes: runs of equal-length messages as whole arrays.

    Stops before the first record that is incomplete or cannot belong into a chunk.
    """
    pieces: list[NDArray[np.int64]] = []
    single: list[int] = []
    others: list[tuple[int, int, int]] = []
    at, size, last, streak, stopped = 0, len(data), -1, 0, ""
    unpack = RECORD_HEADER.unpack_from
    while at + 9 <= size:
        opcode, length = unpack(data, at)
        end = at + 9 + length
        if end > size or (opcode == MESSAGE and length < MESSAGE_HEADER_SIZE):
            stopped = "a record runs past the end" if end > size else "a message is too short"
            break
        if opcode != MESSAGE:
            if opcode not in (SCHEMA, CHANNEL) and opcode < 0x80:
                stopped = f"unexpected record type 0x{opcode:02x}"
                break
            others.append((opcode, at + 9, end))
            at, streak = end, 0
            continue
        streak = streak + 1 if length == last else 0
        last = length
        if streak < _RUN_START:
            single.append(at)
            at = end
            continue
        run = _run(data, at, length)
        pieces += [np.array(single, dtype=np.int64), run]
        single, streak = [], 0
        at = int(run[-1]) + 9 + length
    else:
        stopped = "a record header is incomplete" if at < size else ""
    pieces.append(np.array(single, dtype=np.int64))
    return Walk(np.concatenate(pieces), others, at, stopped)


def _run(data: bytes, at: int, length: int) -> NDArray[np.int64]:
    """Starts of the message records from `at` on that share its length."""
    stride = 9 + length
    rows = (len(data) - at) // stride
    head = np.dtype({"names": ["op", "len"], "formats": ["u1", "<u8"], "offsets": [0, 1]})
    view = np.ndarray((rows,), head, data, at, (stride,))
    count, look = 0, 64
    while count < rows:
        part = view[count : count + look]
        same = (part["len"] == length) & (part["op"] == MESSAGE)
        good = len(same) if same.all() else int(same.argmin())
        count += good
        if good < len(same):
            break
        look *= 4
    return at + stride * np.arange(count, dtype=np.int64)
