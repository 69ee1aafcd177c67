"""Statistics of short windows of samples, one pass, block by block; samples while they are few.

A window is a fixed number of consecutive samples of one channel. It never crosses a gap, a step
back in time, or the end of a block's missing part; what is left over before a gap is dropped.
Only these statistics are kept, so memory is the recording's size over the window's length, and the
samples of a recording as long as they are few enough.
"""

from __future__ import annotations

import mmap
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Index
from imucalib.recording.recording import Channel, Gap, Held, Pending

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


COLUMNS = ("first", "run", "start", "stop", "mean", "variance", "low", "high")
_CACHE = 1 << 19  # bytes that are worked on at a time
_ROOM = 1 << 19  # windows that there is room for at first: two months of ten seconds
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
        self._table = _Table()
        self._finest: Array | None = None
        self._t: Array = np.empty(0)
        self._values: Array | None = None
        self._offset = 0
        self._run = 0

    def add(self, channel: Channel, gaps: Sequence[Gap]) -> None:
        """Take the next block of the channel, with the gaps that the block reports."""
        held, new = self._t.size, channel.values
        near = breaks(np.append(self._t, channel.t[:1]), gaps)  # among the samples held back
        edges = np.union1d(near, held + breaks(channel.t, gaps))
        bounds = [0, *edges.tolist(), held + channel.t.size]
        before, w = self._values, self.samples

        def times(a: int, b: int) -> Array:
            if a >= held:
                return channel.t[a - held : b - held]
            return np.concatenate([self._t[a:b], channel.t[: max(b - held, 0)]])

        def piece(a: int, b: int) -> Array:
            if before is None or a >= held:
                return new[a - held : b - held]
            return np.concatenate([before[a:b], new[: max(b - held, 0)]])

        for k, (a, b) in enumerate(pairwise(bounds)):
            self._run += k > 0
            whole = (b - a) // w * w
            # Only the window that spans two blocks is copied together.
            first = min(whole, -(-(held - a) // w) * w) if a < held else 0
            for low, high in ((a, a + first), (a + first, a + whole)):
                if high > low:
                    part = self._of(times(low, high), piece(low, high), self._offset + low)
                    self._keep(converted(part, channel.pending))
            if k == len(bounds) - 2:
                self._t, self._values = times(a + whole, b).copy(), piece(a + whole, b).copy()
                self._offset += a + whole

    def _of(self, t: Array, values: Array, first: int) -> Windows:
        w = self.samples
        statistics = window_statistics(values.reshape(t.size // w, w, values.shape[1]))
        mean, variance, low, high, finest = statistics
        m = t.size // w
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

    def _keep(self, part: Windows) -> None:
        self._table.extend(np.column_stack([getattr(part, name) for name in COLUMNS]))
        before = self._finest
        self._finest = part.finest if before is None else np.minimum(before, part.finest)

    def windows(self) -> Windows | None:
        """All windows so far; None when no window was ever full."""
        if self._finest is None:
            return None
        rows, k = self._table.rows(), self._finest.size
        first, run = (rows[:, c].astype(np.intp) for c in (0, 1))
        mean, variance, low, high = (rows[:, a : a + k] for a in range(4, 4 + 4 * k, k))
        return Windows(
            samples=self.samples,
            first=first,
            run=run,
            start=rows[:, 2],
            stop=rows[:, 3],
            mean=mean,
            variance=variance,
            low=low,
            high=high,
            finest=self._finest,
        )


class _Table:
    """Rows of numbers that grow, in pages of their own: these are taken when they are written, so
    that room costs nothing, and go back to the system as soon as nothing refers to them."""

    def __init__(self) -> None:
        self._held: Array = np.empty((0, 0))
        self._used = 0

    def extend(self, rows: Array) -> None:
        needed = self._used + len(rows)
        if needed > len(self._held):
            shape = max(_ROOM, 2 * needed), rows.shape[1]
            more = np.frombuffer(mmap.mmap(-1, 8 * shape[0] * shape[1])).reshape(shape)
            if self._used:
                more[: self._used] = self._held[: self._used]
            self._held = more
        self._held[self._used : needed] = rows
        self._used = needed

    def rows(self) -> Array:
        """The rows so far; later ones come after them."""
        return self._held[: self._used]


def converted(windows: Windows, how: Pending | None) -> Windows:
    """The windows in SI, when their numbers are still those of the file."""
    if how is None:
        return windows
    ends = how.apply(windows.low), how.apply(windows.high)
    known = np.isfinite(windows.finest)
    finest = how.sizes(np.where(known, windows.finest, 0.0))
    return replace(
        windows,
        mean=how.apply(windows.mean),
        variance=how.sizes(np.sqrt(windows.variance)) ** 2,
        low=np.minimum(*ends),
        high=np.maximum(*ends),
        finest=np.where(finest > 0.0, finest, np.inf),
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
    return replace(windows, **{n: getattr(windows, n)[keep] for n in COLUMNS}), int((~keep).sum())


def without_held(windows: Windows, held: Sequence[Held]) -> Windows:
    """The windows, in order of time, in which nothing is held; what stands on both sides of such a
    stretch does not follow one another."""
    if not held:
        return windows
    ends = np.array(sorted((h.start, h.stop) for h in held))
    begin, end = ends[:, 0], np.maximum.accumulate(ends[:, 1])
    before = np.searchsorted(begin, windows.stop, side="left")
    within = (before > 0) & (end[np.maximum(before - 1, 0)] > windows.start)
    # Numbers of runs that no other stretch has, whatever those are.
    stretch = np.cumsum(within & ~np.append(False, within[:-1])) << 40
    kept = {name: getattr(windows, name)[~within] for name in COLUMNS}
    return replace(windows, **{**kept, "run": (windows.run + stretch)[~within]})


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


def breaks(t: Array, gaps: Sequence[Gap]) -> Index:
    """Indices i such that sample i does not follow sample i - 1; 0 when it starts a new run."""
    back = np.flatnonzero(t[1:] < t[:-1]) + 1
    found = set(back.tolist())
    bounds = [0, *back.tolist(), t.size]
    middles = np.array([0.5 * (g.start + g.stop) for g in gaps if g.stop > g.start])
    for a, b in pairwise(bounds):
        at = a + np.searchsorted(t[a:b], middles)
        found.update(int(i) for i in at if a < i < b)
    return np.array(sorted(found), dtype=np.intp)
