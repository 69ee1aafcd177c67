"""The quiet stretches of one sensor by itself, to the sample where its samples are at hand.

Still windows that belong together are grouped; some groups are pieces of a slow motion. From the
still windows the search goes outward to the first sample, or the first mean of a few, that the
noise does not explain; then the ends are cut until their means agree with the middle's.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.rests.stillness import Kinds, Sensor, all_axes, kinds_of
from imucalib.rests.windows import KeptSamples
from imucalib.units import DEG

#: Shares of gravity that a mean may go in all, and a second of warm-up beside it.
TILT, WARMING = np.sin(0.3 * DEG), 1e-4 / 60.0
CHANCE = 6.5  # standard errors between the highest and the lowest of a hundred means
_PART = 0.25  # s, of the means, at least
_PARTS = 120  # means, at most
_PAIRS = 10  # neighbouring windows from which the colour of the noise is estimated
_PAIRS_LOOKED_AT = 5000  # pairs, about, that it is estimated from
_REDDEST = 3.0
_WITNESSES = 20  # spans whose whiteness is the usual one
_ALONE = 5.0  # s, of a group that is judged by itself whatever it follows
_STEP = 1e-3  # share of gravity by which neighbouring windows of a group may differ in any case
_FAR = 5.0  # standard deviations of a sample, or of a short mean, that end a rest
_SHORT = 0.08  # s, of the short mean
_GUARD = 0.03  # s that a motion has begun before it shows
#: s that an end is cut short where a motion begins at once, with the guard; and how much of a
#: motion that begins slowly is in a rest.
BLUR = 0.05
_END = 0.3  # s, of the means at the ends
_AGREE = 3.5  # standard errors between an end and the middle
_MOST_CUT = 1.5  # s cut at an end in search of agreement

Interval = tuple[float, float]


@dataclass(frozen=True)
class WindowNoise:
    """sd : (k,) of a sample; colour : how much more a mean scatters than that of white noise."""

    sd: Array
    colour: float

    def of_mean(self, samples: int) -> Array:
        """(k,) standard error of a mean."""
        return np.asarray(self.colour * self.sd / np.sqrt(samples))


def whiteness(values: Array) -> float:
    """Half the mean square of successive differences over the variance, least of the axes: 1 for
    white noise, near 0 for a slow motion (von Neumann, 1941)."""
    variance = values.var(axis=0)
    steps = 0.5 * np.mean(np.square(np.diff(values, axis=0)), axis=0)
    live = variance > 0.0
    return float(np.min(steps[live] / variance[live])) if live.any() else 1.0


@dataclass(frozen=True)
class WindowGroup:
    """Windows (n,) that follow one another without a jump of the mean.

    louder : most of them are at more than the quietest noise
    drifting : a short piece of what goes on, without a moving window or a jump, further than a
        rest may
    """

    windows: Index
    louder: bool
    drifting: bool


def _groups(sensor: Sensor, kinds: Kinds) -> list[WindowGroup]:
    """The groups of a sensor's still windows, in order."""
    w, noise = sensor.windows, sensor.allowed
    chosen = np.flatnonzero(kinds.still)
    if chosen.size == 0:
        return []
    own = np.sqrt(np.maximum(w.variance[chosen], noise**2))
    size = np.maximum(own[1:], own[:-1]) if kinds.louder.any() else noise
    change = np.abs(np.diff(w.mean[chosen], axis=0))
    limit = size + 6.0 * size * np.sqrt(2.0 / w.samples)
    next_to = w.joined(chosen)
    drifting = np.zeros(chosen.size, dtype=np.bool_)
    if not sensor.turns:
        # A turn is judged as a whole: a noise of a few µg must not cut it into rests.
        limit = np.maximum(limit, _STEP * sensor.gravity(kinds.still))
    together = next_to & all_axes(change <= limit)
    if not sensor.turns:
        # What moves between still windows by more than their range is a jump.
        linked = next_to & all_axes(change <= np.maximum(sensor.settings.range_ratio * size, limit))
        drifting = _drifting(sensor, chosen, together, linked)
        together |= linked & drifting[1:] & drifting[:-1]
    return [
        WindowGroup(
            chosen[part], bool(kinds.louder[chosen[part]].mean() > 0.5), bool(drifting[part[0]])
        )
        for part in np.split(np.arange(chosen.size), np.flatnonzero(~together) + 1)
    ]


def _drifting(sensor: Sensor, chosen: Index, together: Flags, linked: Flags) -> Flags:
    """Still windows (m,) of short groups in chains of several that go further than a rest may."""
    drifting = np.zeros(chosen.size, dtype=np.bool_)
    if not np.any(linked & ~together):
        return drifting
    w, error = sensor.windows, sensor.allowed / np.sqrt(sensor.windows.samples)
    owner = np.cumsum(np.append(0, ~together))
    short = np.bincount(owner) * w.samples < _ALONE * sensor.rate
    for chain in np.split(np.arange(chosen.size), np.flatnonzero(~linked) + 1):
        if owner[chain[0]] == owner[chain[-1]]:
            continue
        mean, seconds = w.mean[chosen[chain]], w.stop[chosen[chain[-1]]] - w.start[chosen[chain[0]]]
        limit = (TILT + WARMING * seconds) * float(np.linalg.norm(mean.mean(axis=0)))
        if np.any(np.ptp(mean, axis=0) > limit + CHANCE * error):
            drifting[chain] = short[owner[chain]]
    return drifting


@dataclass(frozen=True)
class Span:
    """A quiet stretch of one sensor: samples first..last (exclusive), times of its first and last
    sample (s), and what its group of windows is."""

    first: int
    last: int
    start: float
    stop: float
    group: WindowGroup


@dataclass(frozen=True)
class SensorView:
    """A sensor, looked at by itself: its windows' kinds and, where they are kept, its samples."""

    sensor: Sensor
    samples: KeptSamples

    @property
    def key(self) -> tuple[str, str]:
        return self.sensor.quantity, self.sensor.triad

    @cached_property
    def kinds(self) -> Kinds:
        return kinds_of(self.sensor)

    @cached_property
    def colour(self) -> float:
        """How much more the means of its windows scatter than white noise would let them; 1 to 3.

        A low-pass filter in the chip makes neighbouring samples depend on each other, so that
        their mean is worth less.
        """
        w, still = self.sensor.windows, self.kinds.still
        pairs = np.flatnonzero(still[1:] & still[:-1] & w.following)
        if pairs.size < _PAIRS:
            return 1.0
        one = pairs[:: max(1, pairs.size // _PAIRS_LOOKED_AT)]
        two, least = one + 1, np.square(self.sensor.step) / 6.0 + np.sqrt(np.finfo(float).tiny)
        ratio = np.square(w.mean[two] - w.mean[one]) * w.samples
        ratio /= w.variance[two] + w.variance[one] + least
        # The median of a squared normal number is 0.455 of its variance.
        return float(np.sqrt(np.clip(np.median(ratio) / 0.455, 1.0, _REDDEST**2)))

    @cached_property
    def usual(self) -> float:
        """Whiteness of its noise at rest."""
        quiet = [s for s in self.spans if not s.group.louder][:_WITNESSES]
        if not self.samples.whole or not quiet:
            return 1.0
        values = (self.samples.values(self.key, s.first, s.last) for s in quiet)
        return float(np.median([whiteness(v) for v in values]))

    @cached_property
    def spans(self) -> list[Span]:
        """Its quiet stretches, in order, none touching another."""
        groups, w = _groups(self.sensor, self.kinds), self.sensor.windows
        if not self.samples.whole:
            return [span for group in groups if (span := self._of_windows(group))]
        found: list[Span] = []
        begins = [int(w.first[g.windows[0]]) for g in groups] + [self.samples.count(self.key)]
        ends = [0] + [int(w.first[g.windows[-1]]) + w.samples for g in groups]
        for k, group in enumerate(groups):
            before = max(ends[k], found[-1].last if found else 0)
            if (span := self._refine(group, (before, begins[k + 1]))) is not None:
                found.append(span)
        return found

    @cached_property
    def _starts(self) -> Array:
        return np.array([span.start for span in self.spans])

    def _of_windows(self, group: WindowGroup) -> Span | None:
        """The span whose ends are windows: one at each end, where the hand still touches, is left
        out."""
        w, inner = self.sensor.windows, group.windows[1:-1]
        if not inner.size:
            return None
        a, b = int(inner[0]), int(inner[-1])
        last = int(w.first[b]) + w.samples
        return Span(int(w.first[a]), last, float(w.start[a]), float(w.stop[b]), group)

    def _refine(self, group: WindowGroup, walls: tuple[int, int]) -> Span | None:
        """The stretch around a group of windows, within walls that belong to other groups."""
        w, own = self.sensor.windows, group.windows
        # Standard deviation of a sample of the group; its own, unless it is a single window's.
        sd = np.maximum(np.sqrt(w.variance[own].mean(axis=0)), self.sensor.allowed)
        noise = WindowNoise(sd, self.colour)
        begin, end = int(w.first[own[0]]), int(w.first[own[-1]]) + w.samples
        low, high = max(walls[0], begin - 2 * w.samples), min(walls[1], end + 2 * w.samples)
        near = w.samples // 2 if own.size == 1 else w.samples
        early, late = w.mean[own[:4]].mean(axis=0), w.mean[own[-4:]].mean(axis=0)
        first = begin + near - self._quiet_ahead((begin + near, low), early, noise)
        last = end - near + self._quiet_ahead((end - near, high), late, noise)
        if not self.sensor.turns:
            values = self.samples.values(self.key, first, last)
            head, tail = _agreeing(values, noise, self.sensor.rate)
            first, last = first + head, first + tail
        if last - first < 2:
            return None
        t = self.samples.times(self.key, first, last)
        return Span(first, last, float(t[0]), float(t[-1]), group)

    def _quiet_ahead(self, way: tuple[int, int], mean: Array, noise: WindowNoise) -> int:
        """How many samples from way[0] towards way[1] are quiet; backwards when that is before."""
        back, rate = way[1] < way[0], self.sensor.rate
        t = self.samples.times(self.key, min(way), max(way))
        values = self.samples.values(self.key, min(way), max(way))
        cuts = self.samples.find_breaks(t)
        if cuts.size:
            values = values[int(cuts[-1]) :] if back else values[: int(cuts[0])]
        off = (values[::-1] if back else values) - mean
        short = max(3, round(_SHORT * rate))
        bad = np.any(np.abs(off) > _FAR * noise.sd, axis=1)
        ends = [int(np.argmax(bad))] if bad.any() else []
        if len(off) > short:
            total = np.cumsum(off, axis=0)
            mean_of = (total[short:] - total[:-short]) / short
            drawn = np.any(np.abs(mean_of) > _FAR * noise.of_mean(short), axis=1)
            ends += [int(np.argmax(drawn)) + 1 + short // 2] if drawn.any() else []
        return max(0, min(ends) - round(_GUARD * rate)) if ends else len(off)

    def quiet_in(self, inside: Interval) -> list[Span]:
        """What an interval has in common with its quiet stretches, in order."""
        first = max(int(np.searchsorted(self._starts, inside[0], side="right")) - 1, 0)
        last = int(np.searchsorted(self._starts, inside[1], side="right"))
        cut = [self._within(span, inside) for span in self.spans[first:last]]
        return [span for span in cut if span.last > span.first]

    def _within(self, span: Span, inside: Interval) -> Span:
        if not self.samples.whole:
            w = self.sensor.windows
            a = int(np.searchsorted(w.start, max(inside[0], span.start), side="left"))
            b = int(np.searchsorted(w.stop, min(inside[1], span.stop), side="right"))
            ends = (int(w.first[a]), int(w.first[b - 1]) + w.samples) if b > a else (0, 0)
        else:
            t = self.samples.times(self.key, span.first, span.last)
            a = int(np.searchsorted(t, inside[0], side="left"))
            ends = span.first + a, span.first + int(np.searchsorted(t, inside[1], side="right"))
        start, stop = max(span.start, inside[0]), min(span.stop, inside[1])
        return Span(*ends, start, stop, span.group)

    def means(self, quiet: list[Span]) -> tuple[Array, int, WindowNoise, float]:
        """Means (m, 3) of equal parts of some stretches, samples of each, its noise and
        whiteness."""
        sensor, floor = self.sensor, self.sensor.step / np.sqrt(12.0)
        if not self.samples.whole:
            rows, w = self._windows_of(quiet), sensor.windows
            own = np.sqrt(w.variance[rows].mean(axis=0)) if rows.size else floor
            return w.mean[rows], w.samples, WindowNoise(np.maximum(own, floor), self.colour), 1.0
        values = self._values(quiet)
        n = len(values)
        if n < 3:
            return np.empty((0, 3)), 1, WindowNoise(floor, self.colour), 1.0
        each = max(1, min(n // 3, max(round(_PART * sensor.rate), -(-n // _PARTS))))
        parts = values[: n // each * each].reshape(n // each, each, -1)
        # Within the parts: a turn must not pass for noise.
        within = parts.var(axis=1, ddof=1).mean(axis=0) if each > 1 else values.var(axis=0)
        noise = WindowNoise(np.maximum(np.sqrt(within), floor), self.colour)
        return parts.mean(axis=1), each, noise, whiteness(values)

    def mean(self, quiet: list[Span]) -> Array:
        """Mean (3,) of some stretches."""
        if self.samples.whole:
            return np.asarray(self._values(quiet).mean(axis=0))
        return np.asarray(self.sensor.windows.mean[self._windows_of(quiet)].mean(axis=0))

    def _values(self, quiet: list[Span]) -> Array:
        """(n, 3) samples of some stretches, one after the other."""
        values = [self.samples.values(self.key, span.first, span.last) for span in quiet]
        return values[0] if len(values) == 1 else np.concatenate([np.empty((0, 3)), *values])

    def _windows_of(self, quiet: list[Span]) -> Index:
        """Windows that some stretches are made of."""
        first = self.sensor.windows.first
        ends = [np.searchsorted(first, [span.first, span.last]) for span in quiet]
        return np.concatenate([np.empty(0, np.intp), *(np.arange(*pair) for pair in ends)])


def _agreeing(values: Array, noise: WindowNoise, rate: float) -> tuple[int, int]:
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
