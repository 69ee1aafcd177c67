"""Samples as they grow, and the facts of a topic that are known only at its end."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array

_PIECE = 4096  # rows of one stretch that is kept to judge the norm at rest
_LARGEST_SLAB = 1 << 20  # rows
_HEAD = 1 << 15  # rows that the sampling period is taken from


Stamps = NDArray[Any]  # int64 or float64, as the file has it


class Growing:
    """Rows appended in slabs, which become one array at the end: nothing is copied meanwhile."""

    def __init__(self, width: int | None, dtype: type, expected: int = 0) -> None:
        self._expected = expected
        self._shape = () if width is None else (width,)
        self._dtype = dtype
        self._slabs: list[NDArray[Any]] = []
        self._used = 0  # rows in the last slab
        self.size = 0

    def append(self, rows: NDArray[Any]) -> None:
        """Copy rows (n,) or (n, width) to the end."""
        while rows.shape[0]:
            if not self._slabs or self._used == self._slabs[-1].shape[0]:
                self._start(rows.shape[0])
            count = min(rows.shape[0], self._slabs[-1].shape[0] - self._used)
            self._slabs[-1][self._used : self._used + count] = rows[:count]
            self._used += count
            self.size += count
            rows = rows[count:]

    def taken(self) -> NDArray[Any]:
        """All rows as one array, and the slabs given up; appending starts anew."""
        if self._slabs:
            self._slabs[-1] = self._slabs[-1][: self._used]
        else:
            self._start(0)
        whole = self._slabs[0] if len(self._slabs) == 1 else np.concatenate(self._slabs)
        self._slabs, self._used, self.size = [], 0, 0
        return whole

    def _start(self, rows: int) -> None:
        # Memory that is not written yet costs nothing, so a slab may be generous.
        first = self._expected if not self._slabs else 0
        rows = max(rows, first, min(self.size, _LARGEST_SLAB), _PIECE if rows else 0)
        self._slabs.append(np.empty((rows, *self._shape), dtype=self._dtype))
        self._used = 0


@dataclass
class ClockFacts:
    """What a clock did over all samples, in its own unit."""

    count: int = 0
    first: Any = 0
    last: Any = 0
    low: Any = 0
    high: Any = 0
    zeros: int = 0
    repeats: int = 0
    backs: int = 0
    late: Any = 0  # the furthest that a stamp lies before an earlier one

    def update(self, stamps: Stamps) -> None:
        """Add consecutive stamps."""
        if stamps.size == 0:
            return
        if self.count:
            steps = np.diff(stamps, prepend=self.last)
        else:
            steps = np.diff(stamps)
            self.first = self.low = self.high = stamps[0].item()
        self.count += stamps.size
        self.zeros += int(stamps.size - np.count_nonzero(stamps))
        self.repeats += int(np.count_nonzero(steps == 0))
        backs = int(np.count_nonzero(steps < 0))
        if backs:
            self.backs += backs
            peaks = np.maximum(np.maximum.accumulate(stamps), self.high)
            self.late = max(self.late, (peaks - stamps).max().item())
        self.last = stamps[-1].item()
        self.low = min(self.low, stamps.min().item())
        self.high = max(self.high, stamps.max().item())


@dataclass
class Survey:
    """Facts of one topic that decide how its samples become channels."""

    width: int  # number of value columns (acceleration, ...)
    stamp: ClockFacts = field(default_factory=ClockFacts)
    log: ClockFacts = field(default_factory=ClockFacts)
    alive: list[bool] = field(default_factory=list)
    pieces: list[dict[int, list[Array]]] = field(default_factory=list)
    head_stamp: list[Stamps] = field(default_factory=list)
    head_log: list[Stamps] = field(default_factory=list)
    rows: int = 0

    def __post_init__(self) -> None:
        self.alive = [False] * self.width
        self.pieces = [{} for _ in range(self.width)]

    def update(
        self, stamps: Stamps | None, log: Stamps, columns: list[Array], *, passing: bool
    ) -> None:
        """Add consecutive samples; the result does not depend on how they are divided.

        passing : whether the columns are given up afterwards, so that what is kept is copied
        """
        start, stop = self.rows, self.rows + log.size
        self.log.update(log)
        if start < _HEAD:
            self.head_log.append(log[: _HEAD - start].copy())
        if stamps is not None:
            self.stamp.update(stamps)
            if start < _HEAD:
                self.head_stamp.append(stamps[: _HEAD - start].copy())
        for i, column in enumerate(columns):
            self.alive[i] = self.alive[i] or bool(column.any())
        for number in _stretches(start // _PIECE, (stop - 1) // _PIECE):
            a, b = max(number * _PIECE, start), min((number + 1) * _PIECE, stop)
            for kept, column in zip(self.pieces, columns, strict=True):
                part = column[a - start : b - start]
                kept.setdefault(number, []).append(part.copy() if passing else part)
        self.rows = stop

    def rest_pieces(self, column: int) -> list[Array]:
        """Stretches of consecutive raw samples from all over the recording."""
        return [np.concatenate(parts) for parts in self.pieces[column].values()]


def _stretches(first: int, last: int) -> list[int]:
    """Stretches 0 to 3 and every power of two: the start in detail, the rest now and then."""
    chosen = [*range(4), *(1 << k for k in range(2, 40))]
    return [number for number in chosen if first <= number <= last]
