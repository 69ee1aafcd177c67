"""Values of many messages on their way into columns, and payloads that were packed one by one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.readers.messages.definition import LayoutError
from imucalib.readers.messages.records import MessageBlock

Widths = tuple[int, ...]  # numbers in each group
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_MOST_INFLATED = 1 << 26  # of one message: no sensor reading is larger


@dataclass(frozen=True)
class Decoded:
    """columns : (n, k) for each group, in the file's numeric types; good : (n,) decoded at all."""

    columns: tuple[NDArray[Any], ...]
    good: NDArray[np.bool_]
    problem: str = ""


class Rows:
    """Record fields at given byte positions; an even spacing needs no gathering."""

    def __init__(self, data: bytes, starts: NDArray[np.int64], dtype: np.dtype[np.void]) -> None:
        self._starts: NDArray[np.int64] | None = starts
        self.count = starts.size
        steps = np.diff(starts)
        if starts.size > 1 and (steps == steps[0]).all() and steps[0] > 0:
            step = int(steps[0])
            self._view = np.ndarray((starts.size,), dtype, data, int(starts[0]), (step,))
            self._starts = None
        else:
            self._view = np.ndarray((len(data) - dtype.itemsize + 1,), dtype, data, 0, (1,))

    def column(self, name: str) -> NDArray[Any]:
        """(n,) or (n, k) values of one field."""
        part = self._view[name]
        return part if self._starts is None else part[self._starts]

    def vectors(self, name: str) -> NDArray[Any]:
        """(n, k): a scalar field is one column."""
        part = self.column(name)
        return part[:, None] if part.ndim == 1 else part


class Filler:
    """Columns of one block while its messages are decoded in any order."""

    def __init__(self, size: int, widths: Widths) -> None:
        self.size, self._widths = size, widths
        self.columns: list[NDArray[Any] | None] = [None] * len(widths)
        self.good = np.zeros(size, dtype=np.bool_)
        self.problem = ""

    def put_column(self, rows: NDArray[np.int64], index: int, values: NDArray[Any]) -> None:
        """One group's values of some messages."""
        current = self.columns[index]
        if current is None and rows.size == self.size:
            self.columns[index] = values
            return
        if current is None:
            current = np.zeros((self.size, values.shape[1]), dtype=values.dtype.newbyteorder("="))
        current[rows] = values
        self.columns[index] = current

    def put(self, rows: NDArray[np.int64], decoded: Decoded) -> None:
        """All groups of some messages, decoded elsewhere."""
        for i, values in enumerate(decoded.columns):
            self.put_column(rows, i, values)
        self.good[rows] = decoded.good
        self.problem = self.problem or decoded.problem

    def decoded(self) -> Decoded:
        """All columns; what was never put is zero and not good."""
        pairs = zip(self.columns, self._widths, strict=True)
        columns = tuple(np.zeros((self.size, w)) if c is None else c for c, w in pairs)
        return Decoded(columns, self.good, self.problem)


def inflate(payload: bytes) -> bytes:
    """A zstd-compressed payload, unpacked; raises LayoutError."""
    from imucalib.readers.mcap import zstd

    try:
        data = zstd.first_frame(payload, _MOST_INFLATED)
    except (zstd.ZstdError, MemoryError) as error:
        raise LayoutError("a compressed message is damaged") from error
    if data[:4] == ZSTD_MAGIC:
        raise LayoutError("a message is compressed twice")
    return data


def inflated(block: MessageBlock) -> MessageBlock:
    """The block with every zstd-compressed payload unpacked; a damaged one becomes empty."""
    pieces = []
    for payload in block.payloads():
        try:
            pieces.append(inflate(payload) if payload[:4] == ZSTD_MAGIC else payload)
        except LayoutError:
            pieces.append(b"")
    lengths = np.array([len(p) for p in pieces], dtype=np.int64)
    return MessageBlock(b"".join(pieces), np.cumsum(lengths) - lengths, lengths, block.offset)
