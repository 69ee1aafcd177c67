"""Recordings as a text table: `time [s]`, then one column an axis, units in the header.

Acceleration, angular rate and temperature come back bit for bit; numbers have the shortest text
that gives the same float64. Channels with their own times get rows of their own, blank elsewhere.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.errors import UsageError
from imucalib.readers.fields.timebase import runs_of
from imucalib.recording.pairing import printable
from imucalib.recording.recording import Channel, Recording
from imucalib.writers import ChannelsChange

#: Columns of a vector, and of a covariance row by row.
_AXES = {3: tuple("xyz"), 9: tuple(a + b for a in "xyz" for b in "xyz")}
_FORMULA = tuple("=+-@")  # what makes a cell a formula
_CELLS = 1 << 20  # numbers that are made into text at a time


class CsvWriter:
    """Writer of text tables; see `imucalib.writers.Writer`."""

    name = "csv"
    suffixes = (".csv",)

    def write_blocks(self, blocks: Iterable[Recording], path: Path) -> None:
        """Write block after block. Raises UsageError when channels differ in times that step back,
        ChannelsChange for a channel that the first block does not have: the heading is written."""
        count, start_ns = 0, None
        empty: dict[str, Channel] = {}  # the first block's channels, without samples
        with path.open("wb") as file:
            out = _Summed(file)
            for recording in blocks:
                channels, start_ns = recording.channels, recording.start_ns
                if channels and not empty:
                    empty = {
                        name: replace(c, t=c.t[:0], values=c.values[:0])
                        for name, c in channels.items()
                    }
                    file.write(_head(0, start_ns, 0))
                    marks = "".join(f"# corrected: {c.to_text()}\n" for c in recording.corrections)
                    if recording.serial:
                        marks += f"# serial number: {printable(recording.serial)}\n"
                    out.write(marks + ",".join(_names(empty)) + "\n")
                if not set(channels) <= set(empty):
                    both = f"{', '.join(empty)}, then {', '.join(channels)}"
                    raise ChannelsChange(both, recording.path)
                if channels:
                    count += _append(out, {**empty, **channels}, recording.path)
            if empty:
                file.seek(0)
                file.write(_head(count, start_ns, out.crc))


WRITER = CsvWriter()


class _Summed:
    """Text on its way into a file as UTF-8, with the CRC-32 of all of it."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self.crc = file, 0

    def write(self, text: str) -> None:
        """Write on."""
        data = text.encode()
        self.crc = zlib.crc32(data, self.crc)
        self._file.write(data)


def _head(rows: int, start_ns: int | None, crc: int) -> bytes:
    """The first line; what is known last has a fixed width, so that it can be filled in then.

    crc : of the lines below; the line has that of these and of its own start
    """
    start = "none" if start_ns is None else str(start_ns)
    stated = f"# imucal recording, rows: {rows:012d}, start_ns: {start}".encode()
    return stated + f", crc32: {zlib.crc32(stated, crc):08x}\n".encode()


def _append(out: _Summed, channels: dict[str, Channel], where: str) -> int:
    t, rows = _union_of_times(channels, where)
    width = 1 + sum(c.values.shape[1] for c in channels.values())
    most = max(1, _CELLS // width)
    for first in range(0, t.size, most):
        block = np.full((min(most, t.size - first), width), "", dtype="U32")
        block[:, 0] = t[first : first + most].astype("U32")
        _fill(block, first, channels, rows)
        out.write("\n".join(map(",".join, block.tolist())) + "\n")
    return int(t.size)


def _names(channels: dict[str, Channel]) -> list[str]:
    names = ["time [s]"]
    for name, channel in channels.items():
        k = channel.values.shape[1]
        axes = _AXES.get(k, range(k))
        names += [
            _heading(f"{name}/{a} [{channel.unit}]" if k > 1 else f"{name} [{channel.unit}]")
            for a in axes
        ]
    return names


def _heading(text: str) -> str:
    """A heading that a spreadsheet takes for text, whatever the file before called its sensors."""
    text = "".join(c if c.isprintable() else "?" for c in text)
    text = f"'{text}" if text.lstrip()[:1] in _FORMULA else text
    return '"' + text.replace('"', '""') + '"' if set(text) & set(',";') else text


def _union_of_times(channels: dict[str, Channel], where: str) -> tuple[Array, dict[str, Index]]:
    """All times, and the row of every sample of every channel."""
    first = next(iter(channels.values())).t
    if all(np.array_equal(c.t, first) for c in channels.values()):
        return first, {name: np.arange(first.size) for name in channels}
    if any((np.diff(c.t) < 0).any() for c in channels.values()):
        raise UsageError(
            "channels with different times that step back do not fit one table",
            where=where,
            remedy="write HDF5 (.h5) instead",
        )
    keys = np.concatenate([_keys(c.t) for c in channels.values()])
    unique, inverse = np.unique(keys, return_inverse=True)
    stops = np.cumsum([c.t.size for c in channels.values()])[:-1]
    parts = np.split(inverse.ravel(), stops)
    return np.asarray(unique["t"]), dict(zip(channels, parts, strict=True))


def _keys(t: Array) -> np.ndarray[tuple[int, ...], np.dtype[np.void]]:
    """(time, how many earlier samples have the same time): equal times stay separate rows."""
    keys = np.empty(t.size, dtype=[("t", "f8"), ("rank", "i8")])
    keys["t"] = t
    *_, keys["rank"] = runs_of(t)
    return keys


def _fill(
    block: np.ndarray[tuple[int, ...], np.dtype[np.str_]],
    first: int,
    channels: dict[str, Channel],
    rows: dict[str, Index],
) -> None:
    column = 1
    for name, channel in channels.items():
        a, b = np.searchsorted(rows[name], [first, first + block.shape[0]])
        at, width = rows[name][a:b] - first, channel.values.shape[1]
        text = channel.values[a:b].astype("U32")
        block[at, column : column + width] = np.where(np.isnan(channel.values[a:b]), "", text)
        column += width
