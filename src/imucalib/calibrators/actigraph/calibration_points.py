"""Calibration points as paper 002 collects them: nine bins, filled while the recording runs.

Each axis has three bins of mean readings, [-1.25, -0.75], [-0.25, 0.25] and [0.75, 1.25] g (eq.
(10)). A point goes into one bin, the first open one that it belongs to; ends of axes come before
their middles, since few postures reach them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.rests.windows import Windows

#: The paper's rule of stillness: seconds of a segment, and max - min (g) on one axis.
SECONDS, RANGE_G = 5.0, 0.12
_HALF_WIDTH = 0.25
#: (axis, centre in g), ends first.
BINS = tuple((axis, c) for c in (-1.0, 1.0, 0.0) for axis in range(3))


def published_still(windows: Windows, unit: float, axis: int = 0) -> Index:
    """Windows whose max - min on one axis is below 0.12 g; `unit` is 1 g in the windows' unit."""
    spread = windows.high[:, axis] - windows.low[:, axis]
    return np.flatnonzero((spread > 0.0) & (spread < RANGE_G * unit))


@dataclass
class PointCollector:
    """Takes points one at a time and keeps those that an open bin needs.

    fewest, most : points of each bin; the paper has 2 and 2, hence 18 points
    """

    fewest: int = 2
    most: int = 2
    points: list[Array] = field(default_factory=list)
    count: list[int] = field(default_factory=lambda: [0] * len(BINS))

    @property
    def ready(self) -> bool:
        """Whether every bin has its minimum."""
        return min(self.count) >= self.fewest

    @property
    def missing(self) -> tuple[str, ...]:
        """Bins below their minimum, in words."""
        pairs = zip(BINS, self.count, strict=True)
        return tuple(f"{'xyz'[a]} near {c:+g} g" for (a, c), n in pairs if n < self.fewest)

    def offer(self, point: Array) -> bool:
        """Take a mean reading (3,) in g if a bin needs it."""
        for k, (axis, centre) in enumerate(BINS):
            if self.count[k] < self.most and abs(point[axis] - centre) <= _HALF_WIDTH:
                self.count[k] += 1
                self.points.append(point)
                return True
        return False


def two_sets(means: Array, fewest: int = 2, most: int = 2) -> tuple[PointCollector, PointCollector]:
    """A set to calibrate with and a distinct one to verify with, from means (n, 3) in g in order.

    What the first has no room for is offered to the second.
    """
    first, second = PointCollector(fewest, most), PointCollector(fewest, most)
    for point in means:
        if not first.offer(point):
            second.offer(point)
        if first.ready and second.ready and min(second.count) >= most:
            break
    return first, second
