"""Every stretch that may have been a rest of all sensors, and the first reason why it is none.

The sensors of a kind vote. Neighbouring windows of a slow turn agree, its ends do not. A turn of
0.025 deg/s changes an axis across gravity by 0.43 mg/s: slower ones are allowed where they stay
short of a third of a degree, and a warm-up may add 0.1 mg a minute to that.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.rests.spans import (
    BLUR,
    CHANCE,
    TILT,
    WARMING,
    Interval,
    SensorView,
    WindowNoise,
)
from imucalib.rests.windows import Windows
from imucalib.units import DEG

_TURNING = np.sin(0.025 * DEG)  # share of gravity a second, at most where it is more than noise
_LEAST = 2.5e-3  # share of gravity that a short turn must go to count
_SURE = 5.0  # standard errors of a rate
_LATE = 0.3  # of a stretch, at both ends, whose means are compared
_WHITE = 0.6  # share of the variance that successive differences of white noise keep, at least
_FEW = 5  # rests from which a gyroscope's bias at rest is known
_BIAS = 0.1 * DEG  # rad/s that a bias at rest may differ from the others' in any case
_SPREAD = 6.0  # standard deviations (by the median) that it may differ
_LONG = 10.0  # s
_LISTED = 4  # windows of a refused stretch, at least
_MOTION = 0.3  # share of gravity: what varies by more is a motion, and no candidate

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


def _drift(means: Array, each: int, noise: WindowNoise, length: float) -> tuple[float, bool]:
    """How far the mean goes (the channel's unit), and whether it is a turn: of the means (m, 3) of
    m neighbouring parts of `each` samples in a stretch of `length` s."""
    m = len(means)
    gravity = float(np.linalg.norm(np.mean(means, axis=0)))
    if m < 2 or length <= 0.0:
        return 0.0, False
    error = noise.of_mean(each)
    spread = np.ptp(means, axis=0)
    limit = (TILT + WARMING * length) * gravity + CHANCE * error
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


def candidates_of(every: Sequence[SensorView]) -> tuple[tuple[Candidate, ...], tuple[str, ...]]:
    """All candidates in order of time, and what is worth saying of those that stand."""
    found = _off_bias([_judge(inside, every) for inside in _common(every)], every)
    for one in every:
        if not one.sensor.turns:
            found = _add_refused(found, one)
    return tuple(sorted(found, key=lambda c: c.start)), tuple(_louder_notes(found, every))


def _common(every: Sequence[SensorView]) -> list[Interval]:
    """Intervals in which, at every moment, more than half of the accelerometers and of the
    gyroscopes are quiet, in order: one loud sample of one chip ends no rest of the others."""
    of_kind, quiet = Counter(one.sensor.turns for one in every), Counter[bool]()
    # Of a start and a stop at one moment the start comes first.
    ends = sorted(
        (at, stops, one.sensor.turns)
        for one in every
        for span in one.spans
        for at, stops in ((span.start, False), (span.stop, True))
    )
    found = list[Interval]()
    begin: float | None = None
    for at, stops, turns in ends:
        quiet[turns] += -1 if stops else 1
        still = all(2 * quiet[kind] > count for kind, count in of_kind.items())
        if begin is not None and not still and at > begin:
            found.append((begin, at))
        begin = (at if begin is None else begin) if still else None
    return found


def _judge(inside: Interval, every: Sequence[SensorView]) -> Candidate:
    settings, whole = every[0].sensor.settings, every[0].samples.whole
    drift, deviation, turning, unsure, fewest = 0.0, 0.0, False, False, np.inf
    for one in every:
        quiet = one.quiet_in(inside)
        means, each, noise, white = one.means(quiet)
        fewest = min(fewest, len(means))
        if one.sensor.turns or not len(means):
            continue
        length, louder = len(means) * each / one.sensor.rate, any(s.group.louder for s in quiet)
        goes, turns = _drift(means, each, noise, length)
        drift, deviation = max(drift, goes), max(deviation, float(noise.sd.max()))
        # Louder samples must be nearly as white as the sensor's usual noise.
        turning |= turns or any(span.group.drifting for span in quiet)
        turning |= louder and white < _WHITE * min(one.usual, 1.0)
        # Without its samples, only long steadiness tells a louder noise from a slow motion.
        unsure |= louder and not whole and length < _LONG
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
        parts = [one.means(one.quiet_in((found[i].start, found[i].stop))) for i in rests]
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
        rests = [c for c in found if not c.reason]
        loud = (any(s.group.louder for s in one.quiet_in((c.start, c.stop))) for c in rests)
        own = [c for c, louder in zip(rests, loud, strict=True) if louder]
        if own:
            ratio = np.median([c.noise for c in own]) / float(np.max(one.sensor.noise))
            notes.append(
                f"{one.sensor.name}: {len(own)} rests, {sum(c.length for c in own):.4g} s, have "
                f"{ratio:.2g} times the noise of the quietest"
            )
    return notes


def _add_refused(found: list[Candidate], one: SensorView) -> list[Candidate]:
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
    parts = np.split(chosen, np.flatnonzero(~w.joined(chosen)) + 1)
    return [part for part in parts if part.size]


def _of_windows(w: Windows, reason: Reason) -> Candidate:
    noise = float(np.sqrt(w.variance.mean(axis=0)).max())
    drift = float(np.ptp(w.mean, axis=0).max())
    return Candidate(float(w.start[0]), float(w.stop[-1]), drift, noise, reason)
