"""Every stretch that may have been a rest, and the first reason why it is none.

- Neighbouring windows of a slow turn agree, its ends do not. A turn of 0.025 deg/s changes an axis
  across gravity by 0.43 mg/s: slower ones are allowed where they stay short of a third of a degree,
  and a warm-up may add 0.1 mg a minute to that.
- Still windows that belong together are grouped; some groups are pieces of a slow motion.
- From the still windows the search goes outward to the first sample, or the first mean of a few,
  that the noise does not explain; then the ends are cut until their means agree with the middle's.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Literal

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.rests.stillness import Kinds, Sensor, every, kinds_of
from imucalib.rests.windows import KeptSamples, Windows
from imucalib.units import DEG

_TILT = np.sin(0.3 * DEG)  # share of gravity that a mean may go in all
_WARMING = 1e-4 / 60.0  # share of gravity a second
_TURNING = np.sin(0.025 * DEG)  # share of gravity a second, at most where it is more than noise
_LEAST = 2.5e-3  # share of gravity that a short turn must go to count
_SURE = 5.0  # standard errors of a rate
_CHANCE = 6.5  # standard errors between the highest and the lowest of a hundred means
_PART = 0.25  # s, of the means, at least
_PARTS = 120  # means, at most
_LATE = 0.3  # of a stretch, at both ends, whose means are compared
_PAIRS = 10  # neighbouring windows from which the colour of the noise is estimated
_PAIRS_LOOKED_AT = 5000  # pairs, about, that it is estimated from
_REDDEST = 3.0
_WHITE = 0.6  # share of the variance that successive differences of white noise keep, at least

Interval = tuple[float, float]
Reason = Literal["", "too short", "turning", "vibrating", "dropouts", "other noise"]


@dataclass(frozen=True)
class Candidate:
    """A stretch of time that is quiet in all sensors, or steady in an accelerometer.

    start, stop : s; drift : how far the mean goes, noise : standard deviation of a sample, both of
    the worst accelerometer's worst axis, m/s² or counts; reason : "" for a rest
    """

    start: float
    stop: float
    drift: float
    noise: float
    reason: Reason

    @property
    def length(self) -> float:
        """s."""
        return self.stop - self.start


def refusals(candidates: Sequence[Candidate]) -> str:
    """In words: how many candidates there were, and what refused them."""
    found = Counter(c.reason for c in candidates if c.reason)
    if not found:
        return "no part of it is still or steady"
    longest = max(c.length for c in candidates if c.reason)
    parts = ", ".join(f"{count} {reason}" for reason, count in found.most_common())
    return f"of what came near one, {parts} (the longest {longest:.3g} s)"


@dataclass(frozen=True)
class WindowNoise:
    """sd : (k,) of a sample; colour : how much more a mean scatters than that of white noise."""

    sd: Array
    colour: float

    def of_mean(self, samples: int) -> Array:
        """(k,) standard error of a mean."""
        return np.asarray(self.colour * self.sd / np.sqrt(samples))


def colour_of(sensor: Sensor, still: Flags) -> float:
    """How much more the means of windows scatter than white noise would let them; 1 to 3.

    A low-pass filter in the chip makes neighbouring samples depend on each other, so that their
    mean is worth less.
    """
    w = sensor.windows
    pairs = np.flatnonzero(still[1:] & still[:-1] & w.following)
    if pairs.size < _PAIRS:
        return 1.0
    one = pairs[:: max(1, pairs.size // _PAIRS_LOOKED_AT)]
    two, least = one + 1, np.square(sensor.step) / 6.0 + np.finfo(float).tiny
    ratio = np.square(w.mean[two] - w.mean[one]) * w.samples
    ratio /= w.variance[two] + w.variance[one] + least
    # The median of a squared normal number is 0.455 of its variance.
    return float(np.sqrt(np.clip(np.median(ratio) / 0.455, 1.0, _REDDEST**2)))


def whiteness(values: Array) -> float:
    """Half the mean square of successive differences over the variance, least of the axes: 1 for
    white noise, near 0 for a slow motion (von Neumann, 1941)."""
    variance = values.var(axis=0)
    steps = 0.5 * np.mean(np.square(np.diff(values, axis=0)), axis=0)
    live = variance > 0.0
    return float(np.min(steps[live] / variance[live])) if live.any() else 1.0


def _drift(means: Array, each: int, noise: WindowNoise, length: float) -> tuple[float, bool]:
    """How far the mean goes (the channel's unit), and whether it is a turn: of the means (m, 3) of
    m neighbouring parts of `each` samples in a stretch of `length` s."""
    m = len(means)
    gravity = float(np.linalg.norm(np.mean(means, axis=0)))
    if m < 2 or length <= 0.0:
        return 0.0, False
    error = noise.of_mean(each)
    spread = np.ptp(means, axis=0)
    limit = (_TILT + _WARMING * length) * gravity + _CHANCE * error
    t = (np.arange(m) - 0.5 * (m - 1)) * length / m
    rate = t @ (means - means.mean(axis=0)) / np.sum(t * t)
    sure = np.abs(rate) > _SURE * error / np.sqrt(np.sum(t * t))
    fast = (np.abs(rate) > _TURNING * gravity) & (np.abs(rate) * length > _LEAST * gravity)
    # Highest less lowest grows with the noise; the difference of the ends does not: it is shown.
    late = max(1, round(_LATE * m))
    moved = np.abs(means[-late:].mean(axis=0) - means[:late].mean(axis=0))
    beyond = np.maximum(spread - 5.0 * error, 0.0)
    size = float(np.max(np.maximum(moved, beyond)))
    return size, bool(np.any(spread > limit) or np.any(sure & fast))


_ALONE = 5.0  # s, of a group that is judged by itself whatever it follows
_STEP = 1e-3  # share of gravity by which neighbouring windows of a group may differ in any case


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
    limit = sensor.settings.drift_ratio * size + 6.0 * size * np.sqrt(2.0 / w.samples)
    next_to = (np.diff(chosen) == 1) & (np.diff(w.run[chosen]) == 0)
    drifting = np.zeros(chosen.size, dtype=np.bool_)
    if not sensor.turns:
        # A turn is judged as a whole: a noise of a few µg must not cut it into rests.
        limit = np.maximum(limit, _STEP * sensor.gravity(kinds.still))
    together = next_to & every(change <= limit)
    if not sensor.turns:
        # What moves between still windows by more than their range is a jump.
        linked = next_to & every(change <= np.maximum(sensor.settings.range_ratio * size, limit))
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
        limit = (_TILT + _WARMING * seconds) * float(np.linalg.norm(mean.mean(axis=0)))
        if np.any(np.ptp(mean, axis=0) > limit + _CHANCE * error):
            drifting[chain] = short[owner[chain]]
    return drifting


_FAR = 5.0  # standard deviations of a sample, or of a short mean, that end a rest
_SHORT = 0.08  # s, of the short mean
_GUARD = 0.03  # s that a motion has begun before it shows
#: s that an end is cut short where a motion begins at once, with the guard; and how much of a
#: motion that begins slowly is in a rest.
BLUR = 0.05
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
        """Of its noise, see `colour_of`."""
        return colour_of(self.sensor, self.kinds.still)

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
            if (span := self._refined(group, (before, begins[k + 1]))) is not None:
                found.append(span)
        return found

    @cached_property
    def _starts(self) -> Array:
        return np.array([span.start for span in self.spans])

    def _of_windows(self, group: WindowGroup) -> Span | None:
        """The span whose ends are windows: one at each end, where the hand still touches, is left
        out."""
        w, trim = self.sensor.windows, self.sensor.settings.trim
        inner = group.windows[trim : group.windows.size - trim]
        if not inner.size:
            return None
        a, b = int(inner[0]), int(inner[-1])
        last = int(w.first[b]) + w.samples
        return Span(int(w.first[a]), last, float(w.start[a]), float(w.stop[b]), group)

    def _refined(self, group: WindowGroup, walls: tuple[int, int]) -> Span | None:
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
        cuts = self.samples.breaks(t)
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

    def span_at(self, inside: Interval) -> Span:
        """The span that an interval lies in."""
        return self.spans[int(np.searchsorted(self._starts, inside[0], side="right")) - 1]

    def samples_in(self, inside: Interval) -> tuple[int, int]:
        """Samples first..last (exclusive) in an interval within one of the spans."""
        span = self.span_at(inside)
        t = self.samples.times(self.key, span.first, span.last)
        a = int(np.searchsorted(t, inside[0], side="left"))
        return span.first + a, span.first + int(np.searchsorted(t, inside[1], side="right"))

    def windows_in(self, inside: Interval) -> tuple[int, int]:
        """Windows from..to (exclusive) that lie wholly in an interval."""
        w = self.sensor.windows
        a = int(np.searchsorted(w.start, inside[0], side="left"))
        return a, max(a, int(np.searchsorted(w.stop, inside[1], side="right")))

    def means(self, inside: Interval) -> tuple[Array, int, WindowNoise, float]:
        """Means (m, 3) of equal parts of a stretch, samples of each, its noise and whiteness."""
        sensor, floor = self.sensor, self.sensor.step / np.sqrt(12.0)
        if not self.samples.whole:
            w = sensor.windows
            a, b = self.windows_in(inside)
            own = np.sqrt(w.variance[a:b].mean(axis=0)) if b > a else floor
            return w.mean[a:b], w.samples, WindowNoise(np.maximum(own, floor), self.colour), 1.0
        a, b = self.samples_in(inside)
        if b - a < 3:
            return np.empty((0, 3)), 1, WindowNoise(floor, self.colour), 1.0
        values, n = self.samples.values(self.key, a, b), b - a
        each = max(1, min(n // 3, max(round(_PART * sensor.rate), -(-n // _PARTS))))
        parts = values[: n // each * each].reshape(n // each, each, -1)
        # Within the parts: a turn must not pass for noise.
        within = parts.var(axis=1, ddof=1).mean(axis=0) if each > 1 else values.var(axis=0)
        noise = WindowNoise(np.maximum(np.sqrt(within), floor), self.colour)
        return parts.mean(axis=1), each, noise, whiteness(values)

    def mean(self, inside: Interval) -> tuple[Array, int, int]:
        """Mean (3,) in an interval, and its samples first..last (exclusive)."""
        if self.samples.whole:
            a, b = self.samples_in(inside)
            return self.samples.values(self.key, a, b).mean(axis=0), a, b
        w = self.sensor.windows
        a, b = self.windows_in(inside)
        return w.mean[a:b].mean(axis=0), int(w.first[a]), int(w.first[b - 1]) + w.samples


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


_FEW = 5  # rests from which a gyroscope's bias at rest is known
_BIAS = 0.1 * DEG  # rad/s that a bias at rest may differ from the others' in any case
_SPREAD = 6.0  # standard deviations (by the median) that it may differ
_LONG = 10.0  # s
_WITNESSES = 20  # spans whose whiteness is the usual one


def candidates_of(every: Sequence[SensorView]) -> tuple[tuple[Candidate, ...], tuple[str, ...]]:
    """All candidates in order of time, and what is worth saying of those that stand."""
    common = [(span.start, span.stop) for span in every[0].spans]
    for one in every[1:]:
        common = _intersect(common, [(span.start, span.stop) for span in one.spans])
    found = []
    longest = every[0].sensor.settings.longest
    for a, b in common:
        pieces = 1 if longest is None else max(1, int(np.ceil((b - a) / longest)))
        ends = np.linspace(a, b, pieces + 1).tolist()
        found += [_judge(part, every) for part in pairwise(ends)]
    found = _off_bias(found, every)
    for one in every:
        if not one.sensor.turns:
            found = _with_refused(found, one)
    return tuple(sorted(found, key=lambda c: c.start)), tuple(_louder_notes(found, every))


def _judge(inside: Interval, every: Sequence[SensorView]) -> Candidate:
    settings, whole = every[0].sensor.settings, every[0].samples.whole
    drift, deviation, turning, unsure, fewest = 0.0, 0.0, False, False, np.inf
    for one in every:
        means, each, noise, white = one.means(inside)
        fewest = min(fewest, len(means))
        if one.sensor.turns or not len(means):
            continue
        length, group = len(means) * each / one.sensor.rate, one.span_at(inside).group
        goes, turns = _drift(means, each, noise, length)
        drift, deviation = max(drift, goes), max(deviation, float(noise.sd.max()))
        # Louder samples must be nearly as white as the sensor's usual noise.
        turning |= turns or group.drifting
        turning |= group.louder and white < _WHITE * min(one.usual, 1.0)
        # Without its samples, only long steadiness tells a louder noise from a slow motion.
        unsure |= group.louder and not whole and length < _LONG
    # Ends stop short of the motion: what they leave was still.
    rate = max(one.sensor.rate for one in every)
    length = inside[1] - inside[0] + (2.0 * BLUR if whole else 0.0) + 1.5 / rate
    reason: Reason = ""
    if fewest < 1 or length < settings.shortest:
        reason = "too short"
    elif turning:
        reason = "turning"
    elif unsure:
        reason = "other noise"
    return Candidate(*inside, drift, deviation, reason)


def _off_bias(found: list[Candidate], every: Sequence[SensorView]) -> list[Candidate]:
    """A rest at which a gyroscope reads another rate than at the others is a turn."""
    rests = [i for i, c in enumerate(found) if not c.reason]
    turning: set[int] = set()
    for one in every:
        if not one.sensor.turns or len(rests) < _FEW:
            continue
        parts = [one.means((found[i].start, found[i].stop)) for i in rests]
        rates = np.array([means.mean(axis=0) for means, *_ in parts])
        errors = np.array([noise.of_mean(n * len(means)) for means, n, noise, _ in parts])
        off = np.abs(rates - np.median(rates, axis=0))
        limit = np.maximum(_BIAS, _SPREAD * 1.4826 * np.median(off, axis=0)) + 5.0 * errors
        turning |= {i for i, far in zip(rests, np.any(off > limit, axis=1), strict=True) if far}
    return [replace(c, reason="turning") if i in turning else c for i, c in enumerate(found)]


def _louder_notes(found: Sequence[Candidate], every: Sequence[SensorView]) -> list[str]:
    notes = []
    for one in every:
        if one.sensor.turns or not any(span.group.louder for span in one.spans):
            continue
        rests = (c for c in found if not c.reason)
        own = [c for c in rests if one.span_at((c.start, c.stop)).group.louder]
        if own:
            ratio = np.median([c.noise for c in own]) / float(np.max(one.sensor.noise))
            notes.append(
                f"{one.sensor.name}: {len(own)} rests, {sum(c.length for c in own):.4g} s, have "
                f"{ratio:.2g} times the noise of the quietest"
            )
    return notes


def _intersect(one: Sequence[Interval], two: Sequence[Interval]) -> list[Interval]:
    """Common parts of two ordered lists of intervals."""
    out, i, j = [], 0, 0
    while i < len(one) and j < len(two):
        start, stop = max(one[i][0], two[j][0]), min(one[i][1], two[j][1])
        if stop > start:
            out.append((start, stop))
        if one[i][1] < two[j][1]:
            i += 1
        else:
            j += 1
    return out


_LISTED = 4  # windows of a refused stretch, at least
_MOTION = 0.3  # share of gravity: what varies by more is a motion, and no candidate


def _with_refused(found: list[Candidate], one: SensorView) -> list[Candidate]:
    """With the stretches that one accelerometer's windows refuse, where nothing else is known.

    They take the place of what was too short in them. Both lists are in order of time.
    """
    w, kinds, shortest = one.sensor.windows, one.kinds, one.sensor.settings.shortest
    loud = _MOTION * one.sensor.gravity()
    looked: tuple[tuple[Reason, Flags, Flags], ...] = (
        ("dropouts", kinds.still | kinds.spiky, kinds.spiky),
        ("vibrating", kinds.shaking, kinds.shaking),
        ("other noise", kinds.other, kinds.other),
        ("turning", kinds.still | kinds.slow, kinds.slow),
    )
    for reason, flags, needed in looked:
        free = flags & ~_overlaps(w.start, w.stop, [c for c in found if c.reason != "too short"])
        runs = [run for run in _runs(w, free) if run.size >= _LISTED and needed[run].any()]
        new = [_of_windows(w.take(run), reason) for run in runs]
        new = [c for c in new if c.length >= shortest and c.noise <= loud]
        over = _overlaps([c.start for c in found], [c.stop for c in found], new)
        kept = [
            c for c, gone in zip(found, over, strict=True) if c.reason != "too short" or not gone
        ]
        found = sorted([*kept, *new], key=lambda c: c.start)
    return found


def _overlaps(
    start: Array | list[float], stop: Array | list[float], others: list[Candidate]
) -> Flags:
    """Which intervals overlap one of some candidates, which are in order and apart."""
    if not others or not len(start):
        return np.zeros(len(start), dtype=np.bool_)
    begin, end = np.array([[c.start, c.stop] for c in others]).T
    at = np.searchsorted(end, start, side="right")
    near = np.minimum(at, len(others) - 1)
    return np.asarray((at < len(others)) & (begin[near] < np.asarray(stop)))


def _runs(w: Windows, flags: Flags) -> list[Index]:
    """Flagged windows that follow one another."""
    chosen = np.flatnonzero(flags)
    apart = (np.diff(chosen) > 1) | (np.diff(w.run[chosen]) != 0)
    return [part for part in np.split(chosen, np.flatnonzero(apart) + 1) if part.size]


def _of_windows(w: Windows, reason: Reason) -> Candidate:
    noise = float(np.sqrt(w.variance.mean(axis=0)).max())
    drift = float(np.ptp(w.mean, axis=0).max())
    return Candidate(float(w.start[0]), float(w.stop[-1]), drift, noise, reason)
