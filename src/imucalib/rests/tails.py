"""The rest before a gap: a worn sensor that falls asleep does so because it has been at rest.

Windows follow one another from the start of a gap-free run, so its last seconds, the ones that
are surely at rest before idle sleep, would be lost or share a window with a movement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.recording.recording import Channel, Gap
from imucalib.rests.windows import Windows, breaks, window_statistics


@dataclass(frozen=True)
class Tail:
    """The last samples of a run: times (w,) s and values (w, k); begin : s, of the run."""

    begin: float
    t: Array
    values: Array


class TailBuilder:
    """Collects the last `samples` samples before every gap, from consecutive blocks."""

    def __init__(self, samples: int) -> None:
        self.samples = samples
        self.tails: list[Tail] = []
        self._t: Array = np.empty(0)
        self._values: Array | None = None
        self._begin = 0.0

    def add(self, channel: Channel, gaps: Sequence[Gap]) -> None:
        """Take the next block of the channel, with the gaps that the block reports."""
        if not channel.t.size:
            return
        w, t, values = self.samples, channel.t, channel.values
        if self._values is None:
            self._begin = float(t[0])
        elif gaps or t.size < w:
            t, values = np.concatenate([self._t, t]), np.concatenate([self._values, values])
        edges = breaks(t, gaps).tolist() if gaps else []
        for a, b in pairwise([0, *edges]):
            if b - a >= w:
                last = values[b - w : b]
                last = channel.pending.apply(last) if channel.pending else last.copy()
                self.tails.append(Tail(self._begin, t[b - w : b].copy(), last))
            self._begin = float(t[b])
        first = max(edges[-1] if edges else 0, t.size - w)
        self._t, self._values = t[first:].copy(), values[first:].copy()


def with_tails(windows: Windows, tails: Sequence[Tail]) -> Windows:
    """The windows and, in order of time, those before gaps; these may overlap the one before."""
    if not tails:
        return windows
    cube = np.stack([tail.values for tail in tails])
    mean, variance, low, high, _ = window_statistics(cube)
    start = np.array([tail.t[0] for tail in tails])
    stop = np.array([tail.t[-1] for tail in tails])
    begin = np.array([tail.begin for tail in tails])
    before = np.searchsorted(windows.start, start, side="right") - 1
    same = (before >= 0) & (windows.start[before] >= begin)
    run = np.where(same, windows.run[before], -1 - np.arange(len(tails)))
    first = np.full(len(tails), -1, np.intp)
    order = np.argsort(np.concatenate([windows.start, start]), kind="stable")

    def joined(name: str, of_tails: Array | Index) -> Array:
        return np.asarray(np.concatenate([getattr(windows, name), of_tails])[order])

    return replace(
        windows,
        first=joined("first", first).astype(np.intp),
        run=joined("run", run).astype(np.intp),
        start=joined("start", start),
        stop=joined("stop", stop),
        mean=joined("mean", mean),
        variance=joined("variance", variance),
        low=joined("low", low),
        high=joined("high", high),
    )


def overlapping(windows: Windows, still: Index) -> Index:
    """Of still windows, those that share samples with the still one before."""
    return still[1:][windows.start[still[1:]] <= windows.stop[still[:-1]]]
