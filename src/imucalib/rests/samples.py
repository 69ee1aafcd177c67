"""The samples of a recording that is read in blocks, as long as they are few enough to keep."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Index
from imucalib.recording.recording import Channel, Gap, Pending
from imucalib.rests.windows import breaks

Key = tuple[str, str]
#: Numbers that are kept of a recording in blocks: 128 MB, or a day of one triad at 65 Hz. A
#: recording that is one block is in memory anyway, and all of it is at hand.
KEPT = 1 << 24

_Part = tuple[int, Array, NDArray[np.generic], Pending | None]


class Samples:
    """Samples of channels, by their index in the channel; `whole` until they became too many."""

    def __init__(self, most: int = KEPT) -> None:
        self.whole = True
        self._most, self._blocks, self._held = most, 0, 0
        self._parts: dict[Key, list[_Part]] = {}
        self._counts: dict[Key, int] = {}
        self._gaps: list[Gap] = []

    def begin_block(self, gaps: Sequence[Gap]) -> None:
        """What follows belongs to the next block, which reports these gaps."""
        self._blocks += 1
        self._gaps.extend(gaps)

    def add(self, key: Key, channel: Channel) -> None:
        """Take a channel of the block."""
        if not self.whole:
            return
        first = self._counts.get(key, 0)
        part = (first, channel.t, channel.values, channel.pending)
        self._parts.setdefault(key, []).append(part)
        self._counts[key] = first + channel.t.size
        self._held += channel.values.size
        if self._blocks > 1 and self._held > self._most:
            self.whole = False
            self._parts.clear()

    def count(self, key: Key) -> int:
        """Samples of a channel."""
        return self._counts[key]

    def times(self, key: Key, first: int, last: int) -> Array:
        """(last - first,) s."""
        found = [
            t[max(first - at, 0) : last - at]
            for at, t, _, _ in self._parts[key]
            if at < last and at + t.size > first
        ]
        return found[0] if len(found) == 1 else np.concatenate([np.empty(0), *found])

    def values(self, key: Key, first: int, last: int) -> Array:
        """(last - first, k) in SI, or counts."""
        found = []
        for at, t, values, pending in self._parts[key]:
            if at < last and at + t.size > first:
                some = values[max(first - at, 0) : last - at]
                found.append(pending.apply(some) if pending else some.astype(float, copy=False))
        return found[0] if len(found) == 1 else np.concatenate(found)

    def breaks(self, t: Array) -> Index:
        """Where a stretch of samples at times t is broken by a gap or a step back of time."""
        near = [g for g in self._gaps if t.size and g.stop > t.min() and g.start < t.max()]
        return breaks(t, near)
