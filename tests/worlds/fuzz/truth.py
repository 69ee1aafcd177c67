"""What was written, sample by sample, and whether what was read is that."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib.recording.recording import Recording


@dataclass(frozen=True)
class Series:
    """ns : (n,) since 1970, or since the first sample of an undated file; values : (n, k), SI"""

    ns: NDArray[np.int64]
    values: NDArray[np.float64]


@dataclass(frozen=True)
class Truth:
    """Sensors by quantity; `tolerance` is relative: 0 where the file holds the numbers in SI."""

    series: dict[str, tuple[Series, ...]]
    tolerance: float = 0.0

    @property
    def samples(self) -> int:
        """All of them."""
        return sum(s.ns.size for sensors in self.series.values() for s in sensors)


@dataclass(frozen=True)
class Compared:
    """Samples that are as written, at the wrong time or twice, and never written; and those that
    are missing from inside a sensor's recording or from its ends."""

    right: int = 0
    moved: int = 0
    invented: int = 0
    missing_inside: int = 0
    missing_ends: int = 0

    @property
    def wrong(self) -> int:
        """Returned, and not as they were written."""
        return self.moved + self.invented


def compare(truth: Truth, recording: Recording) -> Compared:
    """Every returned sample against the samples that were written."""
    right = moved = invented = inside = ends = 0
    for quantity, sensors in truth.series.items():
        channels = [c for c in recording.channels.values() if c.quantity == quantity]
        left = list(sensors)
        for channel in channels:
            # A time that is none, or beyond 64 bits, is no time of the truth.
            seconds = np.nan_to_num(channel.t, nan=-1e9).clip(-1e9, 1e9)
            ns = np.rint(seconds * 1e9).astype(np.int64)
            if not left:
                invented += ns.size
                continue
            ns = ns + (recording.start_ns or 0)
            zero = None if recording.start_ns is None else 0
            found = [_matched(s, ns, channel.values, zero, truth.tolerance) for s in left]
            best = int(np.argmax([hit.size and int((hit >= 0).sum()) for hit, _ in found]))
            hit, known = found[best]
            series = left.pop(best)
            seen = np.unique(hit[hit >= 0])
            right += seen.size
            moved += int((known & (hit < 0)).sum()) + int((hit >= 0).sum()) - seen.size
            invented += int((~known & (hit < 0)).sum())
            span = int(seen[-1] - seen[0] + 1) if seen.size else 0
            inside += span - seen.size
            ends += series.ns.size - span
        ends += sum(s.ns.size for s in left)
    extra = [c for c in recording.channels.values() if c.quantity not in truth.series]
    invented += sum(c.t.size for c in extra)
    return Compared(right, moved, invented, inside, ends)


def _matched(
    series: Series,
    ns: NDArray[np.int64],
    values: NDArray[np.float64],
    zero: int | None,
    rtol: float,
) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """For each sample read the row that was written then, -1 where its values differ; and
    whether such values were written at any time."""
    if values.shape[1] != series.values.shape[1] or not ns.size:
        return np.full(ns.size, -1), np.zeros(ns.size, dtype=bool)
    written = {_key(row): k for k, row in enumerate(series.values)}
    at = np.array([written.get(_key(row), -1) for row in values])
    near = np.isclose(series.values[np.maximum(at, 0)], values, rtol=rtol, atol=0.0, equal_nan=True)
    at = np.where(near.all(axis=1), at, -1)
    known = at >= 0
    if zero is None and known.any():
        # A table without a date may begin anywhere: most of its samples say where.
        ns = ns + int(np.median(series.ns[at[known]] - ns[known]))
    period = int(np.median(np.diff(series.ns))) if series.ns.size > 1 else 1_000_000
    late = np.abs(series.ns[np.maximum(at, 0)] - ns) > 0.3 * period
    return np.where(known & ~late, at, -1), known


def _key(row: NDArray[np.float64]) -> tuple[str, ...]:
    return tuple(f"{v:.6g}" for v in row)
