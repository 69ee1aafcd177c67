"""Statistics of short windows of samples, one pass, block by block.

A window is a fixed number of consecutive samples of one channel. It never crosses a gap, a step
back in time, or the end of a block's missing part; what is left over before a gap is dropped.
Only these statistics are kept, so memory is the recording's size over the window's length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from imucalib.recording import Array, Channel, Gap

Index = NDArray[np.intp]
_CACHE = 1 << 14  # numbers that are worked on at a time
_EVERY = 8  # one in so many pieces is looked at for the resolution


@dataclass(frozen=True)
class Windows:
    """Windows of one channel, in order.

    first : (m,) index of the first sample in the channel; samples : samples in each window
    run : (m,) number of the gap-free run; start, stop : (m,) times of the first and last sample, s
    mean, variance, low, high : (m, k) in the channel's unit and its square; variance with n - 1
    finest : (k,) smallest positive step between neighbouring samples seen, the resolution
    """

    samples: int
    first: Index
    run: Index
    start: Array
    stop: Array
    mean: Array
    variance: Array
    low: Array
    high: Array
    finest: Array


class WindowBuilder:
    """Collects the windows of one channel from consecutive blocks."""

    def __init__(self, samples: int) -> None:
        self.samples = samples
        self._parts: list[Windows] = []
        self._t: Array = np.empty(0)
        self._values: Array | None = None
        self._offset = 0
        self._run = 0

    def add(self, channel: Channel, gaps: Sequence[Gap]) -> None:
        """Take the next block of the channel, with the gaps that the block reports."""
        held = 0 if self._values is None else self._t.size
        t = np.concatenate([self._t, channel.t])
        values = channel.values if not held else np.concatenate([_array(self), channel.values])
        edges = _breaks(t, gaps)
        bounds = [0, *edges.tolist(), t.size]
        for k, (a, b) in enumerate(pairwise(bounds)):
            self._run += k > 0
            last = k == len(bounds) - 2
            whole = (b - a) // self.samples * self.samples
            if whole:
                part = slice(a, a + whole)
                self._parts.append(self._of(t[part], values[part], self._offset + a))
            if last:
                self._t, self._values = t[a + whole : b], values[a + whole : b]
                self._offset += a + whole

    def _of(self, t: Array, values: Array, first: int) -> Windows:
        w = self.samples
        m, k = t.size // w, values.shape[1]
        mean, variance = np.empty((m, k)), np.empty((m, k))
        low, high = np.empty((m, k)), np.empty((m, k))
        finest = np.full(k, np.inf)
        cube = values.reshape(m, w, k)
        size = max(1, _CACHE // (w * k))
        for a in range(0, m, size):
            part = slice(a, min(a + size, m))
            # Samples first: each reduction then runs along contiguous windows, within the cache.
            plane = np.ascontiguousarray(cube[part].transpose(1, 0, 2))
            np.min(plane, axis=0, out=low[part])
            np.max(plane, axis=0, out=high[part])
            if a % (_EVERY * size) == 0:
                steps = np.abs(np.diff(plane, axis=0))
                smallest = np.where(steps > 0, steps, np.inf).min(axis=(0, 1), initial=np.inf)
                finest = np.minimum(finest, smallest)
            np.mean(plane, axis=0, out=mean[part])
            plane -= mean[part]
            np.square(plane, out=plane)
            np.divide(plane.sum(axis=0), max(w - 1, 1), out=variance[part])
        return Windows(
            samples=w,
            first=first + w * np.arange(m),
            run=np.full(m, self._run),
            start=t[::w].copy(),
            stop=t[w - 1 :: w].copy(),
            mean=mean,
            variance=variance,
            low=low,
            high=high,
            finest=finest,
        )

    def windows(self) -> Windows | None:
        """All windows so far; None when no window was ever full."""
        if not self._parts:
            return None

        def joined(name: str) -> NDArray[np.float64]:
            return np.concatenate([getattr(p, name) for p in self._parts])

        finest = np.min([p.finest for p in self._parts], axis=0)
        return Windows(
            samples=self.samples,
            first=joined("first").astype(np.intp),
            run=joined("run").astype(np.intp),
            start=joined("start"),
            stop=joined("stop"),
            mean=joined("mean"),
            variance=joined("variance"),
            low=joined("low"),
            high=joined("high"),
            finest=finest,
        )


def in_order(windows: Windows) -> tuple[Windows, int]:
    """The windows whose time lies after all before them, and how many were left out.

    Time that steps back gives two stretches the same times; only the first can be kept.
    """
    latest = np.maximum.accumulate(windows.stop)
    before = np.concatenate([[-np.inf], latest[:-1]])
    keep = windows.start > before
    if keep.all():
        return windows, 0
    names = ("first", "run", "start", "stop", "mean", "variance", "low", "high")
    return replace(windows, **{n: getattr(windows, n)[keep] for n in names}), int((~keep).sum())


def _array(builder: WindowBuilder) -> Array:
    values = builder._values
    return np.empty((0, 0)) if values is None else values


def _breaks(t: Array, gaps: Sequence[Gap]) -> Index:
    """Indices i such that sample i does not follow sample i - 1; 0 when it starts a new run."""
    back = np.flatnonzero(np.diff(t) < 0) + 1
    found = set(back.tolist())
    bounds = [0, *back.tolist(), t.size]
    middles = np.array([0.5 * (g.start + g.stop) for g in gaps if g.stop > g.start])
    for a, b in pairwise(bounds):
        at = a + np.searchsorted(t[a:b], middles)
        found.update(int(i) for i in at if a < i < b)
    return np.array(sorted(found), dtype=np.intp)
