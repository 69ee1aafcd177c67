"""Every stretch that may have been a rest, and the first reason why it is none.

- Neighbouring windows of a slow turn agree, its ends do not. A turn of 0.025 deg/s changes an axis
  across gravity by 0.43 mg/s: slower ones are allowed where they stay short of a third of a degree,
  and a warm-up may add 0.1 mg a minute to that.
- Still windows that belong together are grouped; some groups are pieces of a slow motion.
- From the still windows the search goes outward to the first sample, or the first mean of a few,
  that the noise does not explain; then the ends are cut until their means agree with the middle's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.rests.levels import Candidate, Kinds, Reason, kinds_of, with_refused
from imucalib.rests.stillness import Sensor, StillSettings, allowed, every, gravity_of
from imucalib.rests.windows import Key, Samples, Windows
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
_PAIRS = 10  # neighbouring windows from which the colour of the noise is told
_PAIRS_LOOKED_AT = 5000  # pairs, about, that it is told from
_REDDEST = 3.0
_WHITE = 0.6  # share of the variance that successive differences of white noise keep, at least


@dataclass(frozen=True)
class Noise:
    """sd : (k,) of a sample; colour : how much more a mean scatters than that of white noise."""

    sd: Array
    colour: float

    def of_mean(self, samples: int) -> Array:
        """(k,) standard error of a mean."""
        return np.asarray(self.colour * self.sd / np.sqrt(samples))


def colour_of(sensor: Sensor, still: Flags) -> float:
    """How much more the means of windows scatter than white noise would let them; 1 to 3.

    A low-pass filter in the chip makes neighbouring samples alike: their mean is worth less.
    """
    w = sensor.windows
    pairs = np.flatnonzero(still[1:] & still[:-1] & (np.diff(w.run) == 0))
    if pairs.size < _PAIRS:
        return 1.0
    one = pairs[:: max(1, pairs.size // _PAIRS_LOOKED_AT)]
    two, least = one + 1, np.square(sensor.step) / 6.0 + np.finfo(float).tiny
    ratio = np.square(w.mean[two] - w.mean[one]) * w.samples
    ratio /= w.variance[two] + w.variance[one] + least
    # The median of a squared normal number is 0.455 of its variance.
    return float(np.sqrt(np.clip(np.median(ratio) / 0.455, 1.0, _REDDEST**2)))


@dataclass(frozen=True)
class Drift:
    """How far a mean goes in a stretch (the channel's unit), and whether the stretch is a turn."""

    size: float
    turning: bool


def drift_of(means: Array, each: int, noise: Noise, length: float) -> Drift:
    """Of the means (m, 3) of m neighbouring parts of `each` samples in a stretch of `length` s."""
    m = len(means)
    gravity = float(np.linalg.norm(np.mean(means, axis=0)))
    if m < 2 or length <= 0.0:
        return Drift(0.0, turning=False)
    error = noise.of_mean(each)
    spread = np.ptp(means, axis=0)
    limit = (_TILT + _WARMING * length) * gravity + _CHANCE * error
    t = (np.arange(m) - 0.5 * (m - 1)) * length / m
    rate = t @ (means - means.mean(axis=0)) / np.sum(t * t)
    sure = np.abs(rate) > _SURE * error / np.sqrt(np.sum(t * t))
    fast = (np.abs(rate) > _TURNING * gravity) & (np.abs(rate) * length > _LEAST * gravity)
    # Highest less lowest grows with the noise; the difference of the ends does not: it is told.
    late = max(1, round(_LATE * m))
    moved = np.abs(means[-late:].mean(axis=0) - means[:late].mean(axis=0))
    beyond = np.maximum(spread - 5.0 * error, 0.0)
    size = float(np.max(np.maximum(moved, beyond)))
    return Drift(size, bool(np.any(spread > limit) or np.any(sure & fast)))


def far_apart(w: Windows, chosen: Index, noise: Array) -> bool:
    """Whether the means of some windows go further than those of a rest may."""
    mean = w.mean[chosen]
    seconds = float(w.stop[chosen[-1]] - w.start[chosen[0]])
    limit = (_TILT + _WARMING * seconds) * float(np.linalg.norm(mean.mean(axis=0)))
    return bool(np.any(np.ptp(mean, axis=0) > limit + _CHANCE * noise / np.sqrt(w.samples)))


def parts_of(values: Array, rate: float) -> tuple[Array, int]:
    """Means (m, 3) of equal parts of a stretch (N, 3), and the samples of each."""
    each = max(1, min(len(values) // 3, max(round(_PART * rate), -(-len(values) // _PARTS))))
    m = len(values) // each
    return values[: m * each].reshape(m, each, -1).mean(axis=1), each


def whiteness(values: Array) -> float:
    """Half the mean square of successive differences over the variance, least of the axes: 1 for
    white noise, near 0 for a slow motion (von Neumann, 1941)."""
    variance = values.var(axis=0)
    steps = 0.5 * np.mean(np.square(np.diff(values, axis=0)), axis=0)
    live = variance > 0.0
    return float(np.min(steps[live] / variance[live])) if live.any() else 1.0


def is_noise(found: float, usual: float) -> bool:
    """Whether louder samples are as white as the sensor's usual noise is, nearly."""
    return found >= _WHITE * min(usual, 1.0)


_ALONE = 5.0  # s, of a group that is judged by itself whatever it follows
_STEP = 1e-3  # share of gravity by which neighbouring windows of a group may differ in any case


@dataclass(frozen=True)
class Group:
    """Windows (n,) that follow one another without a jump of the mean.

    louder : most of them are at more than the quietest noise
    wandering : a short piece of what goes on, without a moving window or a jump, further than a
        rest may
    """

    windows: Index
    louder: bool
    wandering: bool


def groups_of(sensor: Sensor, kinds: Kinds, settings: StillSettings) -> list[Group]:
    """The groups of a sensor's still windows, in order."""
    w, noise = sensor.windows, allowed(sensor, settings)
    chosen = np.flatnonzero(kinds.still)
    if chosen.size == 0:
        return []
    own = np.sqrt(np.maximum(w.variance[chosen], noise**2))
    size = np.maximum(own[1:], own[:-1]) if kinds.louder.any() else noise
    change = np.abs(np.diff(w.mean[chosen], axis=0))
    limit = settings.drift_ratio * size + 6.0 * size * np.sqrt(2.0 / w.samples)
    next_to = (np.diff(chosen) == 1) & (np.diff(w.run[chosen]) == 0)
    wandering = np.zeros(chosen.size, dtype=np.bool_)
    if sensor.quantity == "acceleration":
        # A turn is judged as a whole: a noise of a few µg must not cut it into rests.
        limit = np.maximum(limit, _STEP * gravity_of(sensor, kinds.still))
        together = next_to & every(change <= limit)
        # What moves between still windows by more than their range is a jump.
        linked = next_to & every(change <= np.maximum(settings.range_ratio * size, limit))
        wandering = _wandering(sensor, chosen, together, linked, noise)
        together |= linked & wandering[1:] & wandering[:-1]
    else:
        together = next_to & every(change <= limit)
    return [
        Group(chosen[part], bool(kinds.louder[chosen[part]].mean() > 0.5), bool(wandering[part[0]]))
        for part in np.split(np.arange(chosen.size), np.flatnonzero(~together) + 1)
    ]


def _wandering(
    sensor: Sensor, chosen: Index, together: Flags, linked: Flags, noise: Array
) -> Flags:
    """Still windows (m,) of short groups in chains of several that go further than a rest may."""
    wandering = np.zeros(chosen.size, dtype=np.bool_)
    if not np.any(linked & ~together):
        return wandering
    w = sensor.windows
    owner = np.cumsum(np.append(0, ~together))
    short = np.bincount(owner) * w.samples < _ALONE * sensor.rate
    for chain in np.split(np.arange(chosen.size), np.flatnonzero(~linked) + 1):
        several = owner[chain[0]] != owner[chain[-1]]
        if several and far_apart(w, chosen[chain], noise):
            wandering[chain] = short[owner[chain]]
    return wandering


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


Interval = tuple[float, float]

_FEW = 5  # rests from which a gyroscope's bias at rest is told
_BIAS = 0.1 * DEG  # rad/s that a bias at rest may differ from the others' in any case
_SPREAD = 6.0  # standard deviations (by the median) that it may differ
_LONG = 10.0  # s
_WITNESSES = 20  # spans whose whiteness is the usual one


@dataclass(frozen=True)
class Seen:
    """A sensor with its windows' kinds and its quiet spans."""

    sensor: Sensor
    kinds: Kinds
    spans: list[Span]
    colour: float
    usual: float

    @property
    def key(self) -> Key:
        return self.sensor.quantity, self.sensor.triad

    @cached_property
    def starts(self) -> Array:
        """(n,) s, of the spans."""
        return np.array([span.start for span in self.spans])


def seen(sensor: Sensor, samples: Samples, settings: StillSettings) -> Seen:
    """A sensor, looked at by itself. usual : whiteness of its noise at rest."""
    kinds = kinds_of(sensor, settings)
    spans = spans_of(sensor, kinds, samples, settings)
    one = Seen(sensor, kinds, spans, colour_of(sensor, kinds.still), usual=1.0)
    quiet = [s for s in spans if not s.louder][:_WITNESSES]
    if not samples.whole or not quiet:
        return one
    usual = float(np.median([whiteness(samples.values(one.key, s.first, s.last)) for s in quiet]))
    return replace(one, usual=usual)


def candidates_of(
    every: Sequence[Seen], samples: Samples, settings: StillSettings
) -> tuple[tuple[Candidate, ...], tuple[str, ...]]:
    """All candidates in order of time, and what is worth saying of those that stand."""
    common = [(span.start, span.stop) for span in every[0].spans]
    for one in every[1:]:
        common = _intersect(common, [(span.start, span.stop) for span in one.spans])
    found = [
        _judged(part, every, samples, settings)
        for whole in common
        for part in _parts(whole, settings.longest)
    ]
    found = _beside_bias(found, every, samples)
    for one in every:
        if one.sensor.quantity == "acceleration":
            found = with_refused(found, one.sensor, one.kinds, settings)
    notes = tuple(_louder_notes(found, every))
    return tuple(sorted(found, key=lambda c: c.start)), notes


def samples_in(one: Seen, inside: Interval, samples: Samples) -> tuple[int, int]:
    """Samples first..last (exclusive) of a sensor in an interval within one of its spans."""
    span = _span_at(one, inside)
    t = samples.times(one.key, span.first, span.last)
    a = int(np.searchsorted(t, inside[0], side="left"))
    return span.first + a, span.first + int(np.searchsorted(t, inside[1], side="right"))


def windows_in(w: Windows, inside: Interval) -> tuple[int, int]:
    """Windows from..to (exclusive) that lie wholly in an interval."""
    a = int(np.searchsorted(w.start, inside[0], side="left"))
    return a, max(a, int(np.searchsorted(w.stop, inside[1], side="right")))


def _span_at(one: Seen, inside: Interval) -> Span:
    return one.spans[int(np.searchsorted(one.starts, inside[0], side="right")) - 1]


def _parts(whole: Interval, longest: float | None) -> list[Interval]:
    pieces = 1 if longest is None else max(1, int(np.ceil((whole[1] - whole[0]) / longest)))
    ends = np.linspace(*whole, pieces + 1)
    return [(float(a), float(b)) for a, b in pairwise(ends)]


def _judged(
    inside: Interval, every: Sequence[Seen], samples: Samples, settings: StillSettings
) -> Candidate:
    drift, noise, turning, unsure, fewest = 0.0, 0.0, False, False, np.inf
    rate = max(one.sensor.rate for one in every)
    for one in every:
        means, each, sd, white = _means(one, inside, samples)
        fewest = min(fewest, len(means))
        if one.sensor.quantity != "acceleration" or not len(means):
            continue
        length = len(means) * each / one.sensor.rate
        own = drift_of(means, each, Noise(sd, one.colour), length)
        drift = max(drift, own.size)
        noise = max(noise, float(sd.max()))
        span = _span_at(one, inside)
        turning |= own.turning or span.wandering
        turning |= span.louder and not is_noise(white, one.usual)
        # Without its samples, only long steadiness tells a louder noise from a slow motion.
        unsure |= span.louder and not samples.whole and length < _LONG
    # Ends stop short of the motion: what they leave was still.
    length = inside[1] - inside[0] + (2.0 * BLUR if samples.whole else 0.0) + 1.5 / rate
    reason: Reason = ""
    if fewest < 1 or length < settings.shortest:
        reason = "too short"
    elif turning:
        reason = "turning"
    elif unsure:
        reason = "other noise"
    return Candidate(*inside, drift, noise, reason)


def _means(one: Seen, inside: Interval, samples: Samples) -> tuple[Array, int, Array, float]:
    """Means (m, 3) of the parts of a sensor's stretch, samples of each, deviation, whiteness."""
    sensor, floor = one.sensor, one.sensor.step / np.sqrt(12.0)
    if not samples.whole:
        w = sensor.windows
        a, b = windows_in(w, inside)
        own = np.sqrt(w.variance[a:b].mean(axis=0)) if b > a else floor
        return w.mean[a:b], w.samples, np.maximum(own, floor), 1.0
    a, b = samples_in(one, inside, samples)
    if b - a < 3:
        return np.empty((0, 3)), 1, floor, 1.0
    values = samples.values(one.key, a, b)
    means, each = parts_of(values, sensor.rate)
    # Within the parts: a turn must not pass for noise.
    inner = values[: len(means) * each].reshape(len(means), each, -1)
    within = inner.var(axis=1, ddof=1).mean(axis=0) if each > 1 else values.var(axis=0)
    return means, each, np.maximum(np.sqrt(within), floor), whiteness(values)


def _beside_bias(
    found: list[Candidate], every: Sequence[Seen], samples: Samples
) -> list[Candidate]:
    """A rest at which a gyroscope reads another rate than at the others is a turn."""
    rests = [i for i, c in enumerate(found) if not c.reason]
    turning: set[int] = set()
    for one in every:
        if one.sensor.quantity != "angular_rate" or len(rests) < _FEW:
            continue
        rates, errors = [], []
        for i in rests:
            means, each, sd, _ = _means(one, (found[i].start, found[i].stop), samples)
            rates.append(means.mean(axis=0))
            errors.append(Noise(sd, one.colour).of_mean(each * len(means)))
        off = np.abs(np.array(rates) - np.median(rates, axis=0))
        usual = 1.4826 * np.median(off, axis=0)
        limit = np.maximum(_BIAS, _SPREAD * usual) + 5.0 * np.array(errors)
        turning |= {i for i, far in zip(rests, np.any(off > limit, axis=1), strict=True) if far}
    return [replace(c, reason="turning") if i in turning else c for i, c in enumerate(found)]


def _louder_notes(found: Sequence[Candidate], every: Sequence[Seen]) -> list[str]:
    notes = []
    for one in every:
        if not any(span.louder for span in one.spans):
            continue
        own = [c for c in found if not c.reason and _span_at(one, (c.start, c.stop)).louder]
        if own and one.sensor.quantity == "acceleration":
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
