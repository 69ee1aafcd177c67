"""Statistics of short windows of samples, one pass, block by block; samples while they are few.

A window is a fixed number of consecutive samples of one channel. It never crosses a gap, a step
back in time, or the end of a block's missing part; what is left over before a gap is dropped.
Only these statistics are kept, so memory is the recording's size over the window's length, and the
samples of a recording as long as they are few enough.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Flags, Index
from imucalib.errors import Undetermined
from imucalib.recording.recording import Channel, Gap, HeldSamples

Key = tuple[str, str]
#: Numbers that are kept of a recording in blocks: 128 MB, or a day of one triad at 65 Hz. A
#: recording that is one block is in memory anyway, and all of it is at hand.
KEPT = 1 << 24
_COLUMNS = ("first", "run", "start", "stop", "mean", "variance", "low", "high")
_CACHE = 1 << 19  # bytes that are worked on at a time
_EVERY = 8  # one in so many pieces is looked at for the resolution


class KeptSamples:
    """Samples of channels, by their index in the channel; `whole` until they became too many."""

    def __init__(self, most: int = KEPT) -> None:
        self.whole = True
        self._most, self._blocks, self._held = most, 0, 0
        self._parts: dict[Key, list[tuple[int, Channel]]] = {}
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
        self._parts.setdefault(key, []).append((first, channel))
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
        found = [part.t[rows] for part, rows in self._within(key, first, last)]
        return found[0] if len(found) == 1 else np.concatenate([np.empty(0), *found])

    def values(self, key: Key, first: int, last: int) -> Array:
        """(last - first, k) in SI, or counts."""
        found = [part.values[rows] for part, rows in self._within(key, first, last)]
        return found[0] if len(found) == 1 else np.concatenate(found)

    def _within(self, key: Key, first: int, last: int) -> Iterator[tuple[Channel, slice]]:
        for at, part in self._parts[key]:
            if at < last and at + part.t.size > first:
                yield part, slice(max(first - at, 0), last - at)

    def find_breaks(self, t: Array) -> Index:
        """Where a stretch of samples at times t is broken by a gap or a step back of time."""
        within = [g for g in self._gaps if t.size and g.stop > t.min() and g.start < t.max()]
        return find_breaks(t, within)


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

    def take(self, rows: Index | Flags) -> Windows:
        """Some of the windows."""
        return replace(self, **{name: getattr(self, name)[rows] for name in _COLUMNS})

    @property
    def middle(self) -> Array:
        """(m,) s."""
        return np.asarray(0.5 * (self.start + self.stop))

    @property
    def following(self) -> Flags:
        """(m - 1,) whether the next window is of the same run."""
        return np.asarray(np.diff(self.run) == 0)

    def joined(self, rows: Index) -> Flags:
        """(k - 1,) of some windows in order, whether each follows the one before in its run."""
        return np.asarray((np.diff(rows) == 1) & (np.diff(self.run[rows]) == 0))


def join_windows(parts: Sequence[Windows]) -> Windows:
    """Windows of one channel, one part behind the other."""
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(p, name) for p in parts]) for name in _COLUMNS
    }
    return replace(parts[0], finest=np.min([p.finest for p in parts], axis=0), **columns)


class WindowBuilder:
    """Collects the windows of one channel from consecutive blocks."""

    def __init__(self, samples: int) -> None:
        self.samples = samples
        self._parts: list[Windows] = []
        self._t: Array = np.empty(0)
        self._values: NDArray[np.generic] | None = None
        self._offset = self._run = 0

    def add(self, channel: Channel, gaps: Sequence[Gap]) -> None:
        """Take the next block of the channel, with the gaps that the block reports."""
        t, values, w = channel.t, channel.values, self.samples
        if self._values is not None and self._t.size:
            t, values = np.concatenate([self._t, t]), np.concatenate([self._values, values])
        end = 0
        for k, (a, b) in enumerate(pairwise([0, *find_breaks(t, gaps).tolist(), t.size])):
            self._run += k > 0
            end = a + (b - a) // w * w
            if end > a:
                self._parts.append(self._of(t[a:end], values[a:end], self._offset + a))
        self._t, self._values = t[end:].copy(), values[end:].copy()
        self._offset += end

    def _of(self, t: Array, values: NDArray[np.generic], first: int) -> Windows:
        w, m = self.samples, t.size // self.samples
        mean, variance, low, high, finest = window_statistics(values.reshape(m, w, -1))
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
        self._parts = [join_windows(self._parts)]
        return self._parts[0]


def in_order(windows: Windows) -> tuple[Windows, int]:
    """The windows whose time lies after all before them, and how many were left out.

    Time that steps back gives two stretches the same times; only the first can be kept.
    """
    latest = np.maximum.accumulate(windows.stop)
    keep = windows.start > np.concatenate([[-np.inf], latest[:-1]])
    return windows if keep.all() else windows.take(keep), int((~keep).sum())


def drop_held(windows: Windows, held: Sequence[HeldSamples]) -> Windows:
    """The windows, in order of time, in which nothing is held; what stands on both sides of such a
    stretch does not follow one another."""
    if not held:
        return windows
    begin, end = np.array(sorted((h.start, h.stop) for h in held)).T
    end = np.maximum.accumulate(end)
    before = np.searchsorted(begin, windows.stop, side="left")
    within = (before > 0) & (end[np.maximum(before - 1, 0)] > windows.start)
    # Numbers of runs that no other stretch has, whatever those are.
    stretch = np.cumsum(within & ~np.append(False, within[:-1])) << 40
    return replace(windows, run=windows.run + stretch).take(~within)


def usable_windows(
    builder: WindowBuilder,
    held: Sequence[HeldSamples],
    name: str,
    path: str,
    longer: str = "record longer",
    with_more: Callable[[Windows], Windows] = lambda windows: windows,
) -> tuple[Windows, int]:
    """Windows of a channel in order of time, in which nothing is held, and how many were left out
    since time had stepped back. Raises Undetermined where there are none.

    held : of the recording; name : of the channel
    longer : remedy where no window is full; with_more : adds others of the channel, in order
    """
    windows = builder.windows()
    if windows is None:
        raise Undetermined(
            f"{name} has no {builder.samples} samples in a row without a gap",
            where=path,
            remedy=longer,
        )
    ordered, lost = in_order(windows)
    ordered = drop_held(with_more(ordered), [h for h in held if h.channel == name])
    if not ordered.start.size:
        raise Undetermined(
            f"{name} repeats one reading in every stretch of {builder.samples} samples",
            where=path,
            remedy="record it without a step that fills or holds samples",
        )
    return ordered, lost


def window_statistics(cube: NDArray[np.generic]) -> tuple[Array, Array, Array, Array, Array]:
    """Mean, variance, low and high (m, k), and the finest step (k,), of windows (m, w, k).

    As many windows at a time as the cache holds are turned, so that every reduction runs along
    neighbouring numbers. Single precision stays so: it is counted from the first sample, and a
    difference of two such numbers loses nothing that their noise would not hide.
    """
    m, w, k = cube.shape
    kind = np.result_type(cube.dtype, np.float32)
    mean, variance, low, high = (np.empty((m, k)) for _ in range(4))
    finest = np.full(k, np.inf)
    size = max(1, _CACHE // (w * k * kind.itemsize))
    turned, ones = np.empty((min(size, m), k, w), kind), np.ones(w, kind)
    for a in range(0, m, size):
        part = slice(a, min(a + size, m))
        rows = turned[: part.stop - a]
        rows[:] = cube[part].transpose(0, 2, 1)
        low[part], high[part] = rows.min(axis=2), rows.max(axis=2)
        if a % (_EVERY * size) == 0:
            steps = np.abs(np.diff(rows, axis=2))
            smallest = steps.min(axis=(0, 2), where=steps > 0, initial=np.inf)
            finest = np.minimum(finest, smallest)
        first = rows[:, :, :1].copy()
        rows -= first
        total = np.vecdot(rows, ones).astype(np.float64)
        square = np.vecdot(rows, rows)
        mean[part] = first[:, :, 0] + total / w
        variance[part] = np.maximum(square - total**2 / w, 0.0) / max(w - 1, 1)
    return mean, variance, low, high, finest


def find_breaks(t: Array, gaps: Sequence[Gap]) -> Index:
    """Indices i such that sample i does not follow sample i - 1; 0 when it starts a new run."""
    back = np.flatnonzero(t[1:] < t[:-1]) + 1
    found = set(back.tolist())
    bounds = [0, *back.tolist(), t.size]
    middles = np.array([0.5 * (g.start + g.stop) for g in gaps if g.stop > g.start])
    for a, b in pairwise(bounds):
        at = a + np.searchsorted(t[a:b], middles)
        found.update(int(i) for i in at if a < i < b)
    return np.array(sorted(found), dtype=np.intp)
