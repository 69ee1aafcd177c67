"""Every stretch that may have been a rest, and the first reason why it is none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from imucalib.arrays import Array
from imucalib.rests.drift import Noise, colour_of, drift_of, is_noise, parts_of, whiteness
from imucalib.rests.edges import BLUR, Span, spans_of
from imucalib.rests.levels import Kinds, kinds_of
from imucalib.rests.refused import Candidate, Reason, with_refused
from imucalib.rests.samples import Key, Samples
from imucalib.rests.stillness import Sensor, StillSettings
from imucalib.rests.windows import Windows
from imucalib.units import DEG

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
