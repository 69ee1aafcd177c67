"""Idle sleep in exported tables: an ActiGraph that rests stops recording, and the export repeats
the last reading until it wakes. Repeated rows are no measurement, so they become a gap.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.recording.recording import Channel, Gap, Recording

_SHORTEST = 1.0  # s: no sensor whose noise exceeds its resolution repeats itself for so long


def without_repeats(blocks: Iterator[Recording]) -> Iterator[Recording]:
    """The same blocks without accelerations that repeat the one before for over a second.

    The device sleeps by whole seconds, so what is left of the stretch's first second stays. The
    stretch at a block's end waits for the next block.
    """
    awake: dict[str, _Awake] = {}
    before: Recording | None = None
    for block in blocks:
        if before is not None:
            yield _filtered(before, awake, last=False)
        before = block
    if before is not None:
        yield _filtered(before, awake, last=True)


def _filtered(block: Recording, awake: dict[str, _Awake], *, last: bool) -> Recording:
    channels, gaps, notes = dict(block.channels), list(block.gaps), list(block.notes)
    for name, channel in block.channels.items():
        if channel.quantity != "acceleration":
            continue
        state = awake.setdefault(name, _Awake(channel.rate))
        channels[name], found = state.take(channel, last=last)
        gaps += found
        if last and state.repeated:
            notes.append(f"{state.repeated} rows that repeat the last (idle sleep) left out")
    return replace(block, channels=channels, gaps=tuple(gaps), notes=tuple(notes))


class _Awake:
    """The stretch of equal rows at the end of what was seen of one channel.

    held : its rows, or its first second once it is too long, with `dropped` rows gone already
    repeated : rows left out so far
    """

    def __init__(self, rate: float) -> None:
        self.most = max(2, round(_SHORTEST * rate))
        self.repeated = 0
        self._held: tuple[Array, Array] | None = None
        self._dropped = 0

    def take(self, channel: Channel, *, last: bool) -> tuple[Channel, list[Gap]]:
        """The rows that are measurements, and the gaps that the others leave."""
        t, values = channel.t, channel.values
        if self._held is not None:
            t = np.concatenate([self._held[0], t])
            values = np.concatenate([self._held[1], values])
        changed = np.any(values[1:] != values[:-1], axis=1)
        starts = np.concatenate([[0], np.flatnonzero(changed) + 1])
        stops = np.append(starts[1:], t.size)
        length = stops - starts
        length[0] += self._dropped
        long = length > self.most
        end = t.size
        if not last:
            end = int(starts[-1])
            stop = _second(t, end) if long[-1] else t.size
            self._dropped = int(length[-1]) - (stop - end) if long[-1] else 0
            self._held = (t[end:stop].copy(), values[end:stop].copy())
            starts, stops, length, long = starts[:-1], stops[:-1], length[:-1], long[:-1]
        keep = np.ones(end, dtype=np.bool_)
        gaps = []
        for a, b, rows in zip(starts[long], stops[long], length[long], strict=True):
            first = _second(t, int(a))
            keep[first:b] = False
            self.repeated += int(rows) - (first - int(a))
            if b < t.size:
                reason = "idle sleep: the last reading repeated"
                gaps.append(Gap(float(t[first - 1]), float(t[b]), reason))
        return replace(channel, t=t[:end][keep], values=values[:end][keep]), gaps


def _second(t: Array, row: int) -> int:
    """The first row after the second (counted from the start) in which a row lies."""
    return int(np.searchsorted(t, np.floor(t[row] + 1e-6) + 1.0 - 1e-6))
