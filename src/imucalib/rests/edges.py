"""Where a sensor's quiet stretch begins and ends: to the sample where samples are at hand.

From the still windows the search goes outward to the first sample, or the first mean of a few,
that the noise does not explain; then the ends are cut until their means agree with the middle's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.rests.drift import Noise, colour_of
from imucalib.rests.grouping import Group, groups_of
from imucalib.rests.levels import Kinds
from imucalib.rests.samples import Key, Samples
from imucalib.rests.stillness import Sensor, StillSettings, allowed

_FAR = 5.0  # standard deviations of a sample, or of a short mean, that end a rest
_SHORT = 0.08  # s, of the short mean
GUARD = 0.03  # s that a motion has begun before it shows
BLUR = 0.05  # s that an end is cut short where a motion begins at once, with the guard
_END = 0.3  # s, of the means at the ends
_AGREE = 3.5  # standard errors between an end and the middle
_MOST_CUT = 1.5  # s cut at an end in search of agreement


@dataclass(frozen=True)
class Span:
    """A quiet stretch of one sensor: samples first..last (exclusive), times of its first and last
    sample (s), and what its group of windows is."""

    first: int
    last: int
    start: float
    stop: float
    louder: bool
    wandering: bool


def spans_of(sensor: Sensor, kinds: Kinds, samples: Samples, settings: StillSettings) -> list[Span]:
    """The quiet stretches of a sensor, in order, none touching another."""
    groups = groups_of(sensor, kinds, settings)
    if not samples.whole:
        return _of_windows(sensor, groups, settings)
    found: list[Span] = []
    colour = colour_of(sensor, kinds.still)
    ends = [int(sensor.windows.first[g.windows[-1]]) + sensor.windows.samples for g in groups]
    following = [int(sensor.windows.first[g.windows[0]]) for g in groups[1:]]
    following.append(samples.count((sensor.quantity, sensor.triad)))
    for k, group in enumerate(groups):
        before = max(ends[k - 1] if k else 0, found[-1].last if found else 0)
        noise = Noise(_deviation(sensor, group.windows, settings), colour)
        walls = (before, following[k])
        span = _refined(sensor, group, samples, noise, walls)
        if span is not None:
            found.append(span)
    return found


def _of_windows(sensor: Sensor, groups: list[Group], settings: StillSettings) -> list[Span]:
    """Spans whose ends are windows: one at each end, where the hand still touches, is left out."""
    w, spans, trim = sensor.windows, [], settings.trim
    for group in groups:
        inner = group.windows[trim : group.windows.size - trim]
        if inner.size:
            a, b = int(inner[0]), int(inner[-1])
            ends = int(w.first[a]), int(w.first[b]) + w.samples
            times = float(w.start[a]), float(w.stop[b])
            spans.append(Span(*ends, *times, group.louder, group.wandering))
    return spans


def _refined(
    sensor: Sensor, group: Group, samples: Samples, noise: Noise, walls: tuple[int, int]
) -> Span | None:
    """The stretch around a group of windows, within walls that belong to other groups."""
    w, key = sensor.windows, (sensor.quantity, sensor.triad)
    own = group.windows
    a, b = int(own[0]), int(own[-1])
    inner = (int(w.first[a]), int(w.first[b]) + w.samples)
    low, high = max(walls[0], inner[0] - 2 * w.samples), min(walls[1], inner[1] + 2 * w.samples)
    near = w.samples // 2 if a == b else w.samples
    early, late = w.mean[own[:4]].mean(axis=0), w.mean[own[-4:]].mean(axis=0)
    start, end = inner[0] + near, inner[1] - near
    first = start - _quiet_ahead(samples, key, (start, low), early, noise, sensor.rate)
    last = end + _quiet_ahead(samples, key, (end, high), late, noise, sensor.rate)
    if sensor.quantity == "acceleration":
        head, tail = _agreeing(samples.values(key, first, last), noise, sensor.rate)
        first, last = first + head, first + tail
    if last - first < 2:
        return None
    t = samples.times(key, first, last)
    return Span(first, last, float(t[0]), float(t[-1]), group.louder, group.wandering)


def _deviation(sensor: Sensor, group: Index, settings: StillSettings) -> Array:
    """(3,) standard deviation of a sample of the group; its own, unless it is a single window's."""
    level = allowed(sensor, settings)
    own = np.sqrt(sensor.windows.variance[group].mean(axis=0))
    return np.asarray(np.maximum(own, level))


def _quiet_ahead(
    samples: Samples, key: Key, way: tuple[int, int], mean: Array, noise: Noise, rate: float
) -> int:
    """How many samples from way[0] towards way[1] are quiet; backwards when that is before it."""
    start, end = way
    back = end < start
    low, high = min(way), max(way)
    t, values = samples.times(key, low, high), samples.values(key, low, high)
    cuts = samples.breaks(t)
    if cuts.size:
        broken = int(cuts[-1]) if back else int(cuts[0])
        values = values[broken:] if back else values[:broken]
    off = (values[::-1] if back else values) - mean
    short = max(3, round(_SHORT * rate))
    bad = np.any(np.abs(off) > _FAR * noise.sd, axis=1)
    ends = [int(np.argmax(bad))] if bad.any() else []
    if len(off) > short:
        total = np.cumsum(off, axis=0)
        mean_of = (total[short:] - total[:-short]) / short
        drawn = np.any(np.abs(mean_of) > _FAR * noise.of_mean(short), axis=1)
        ends += [int(np.argmax(drawn)) + 1 + short // 2] if drawn.any() else []
    if not ends:
        return len(off)
    return max(0, min(ends) - round(GUARD * rate))


def _agreeing(values: Array, noise: Noise, rate: float) -> tuple[int, int]:
    """First and last (exclusive) of the samples whose ends agree with their middle."""
    end = max(3, round(_END * rate))
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values - values[0], axis=0)])
    first, last = 0, len(values)
    step, most = max(1, end // 6), round(_MOST_CUT * rate)

    def apart(a: int, b: int, c: int, d: int) -> bool:
        change = (total[b] - total[a]) / (b - a) - (total[d] - total[c]) / (d - c)
        error = np.hypot(noise.of_mean(b - a), noise.of_mean(d - c))
        return bool(np.any(np.abs(change) > _AGREE * error))

    while last - first >= 3 * end:
        middle = first + end, last - end
        head = apart(first, first + end, *middle) and first < most
        tail = apart(last - end, last, *middle) and len(values) - last < most
        if not (head or tail):
            break
        first, last = first + step * head, last - step * tail
    # What agrees with itself only in a smaller half is a turn, to be judged as it is.
    return (first, last) if 2 * (last - first) >= len(values) else (0, len(values))
