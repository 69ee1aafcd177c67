"""Every window of a sensor gets a kind: still, still at a louder noise, shaking, with dropouts.

A sensor's noise may change in the middle of a recording, with a range, a filter, a machine beside
it. Windows that are steady, neighbour like neighbour, at a noise that many of them share are rests
at that noise; what shakes by more is none, whatever its mean does. Candidates for rests are here
too, and those that an accelerometer's windows refuse by themselves.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.rests.stillness import (
    Sensor,
    StillSettings,
    allowed,
    every,
    gravity_of,
    loudest,
    some,
    still_windows,
)
from imucalib.rests.windows import Windows

_LOUDER = 5.0  # times the quietest noise that a sensor's own noise may grow to
_LEVELS = 2  # louder noises that are looked for
_SHARED = 10  # windows that must share a louder noise
_ALIKE = 4.0  # ratio of the variances of neighbours, at most; standard errors between their means
_SLOW = 0.03  # share of gravity that a slow turn may change the reading by in a window
_OUTLIER = 0.1  # share of gravity by which a dropout differs from the samples around it


@dataclass(frozen=True)
class Kinds:
    """Flags (m,) of a sensor's windows.

    still : at rest, at the sensor's noise or a louder one that many windows share
    louder : of these, at the louder one
    other : steady at a noise of their own, which too few windows share to believe in
    shaking : steady, but louder than the sensor's noise can be
    slow : not still, but moving so little that it is a turn rather than a motion
    spiky : one sample far from all others, as a dropout is
    """

    still: Flags
    louder: Flags
    other: Flags
    shaking: Flags
    slow: Flags
    spiky: Flags
    notes: tuple[str, ...]


def kinds_of(sensor: Sensor, settings: StillSettings) -> Kinds:
    """The kinds of a sensor's windows."""
    w = sensor.windows
    still, notes = still_windows(sensor, settings)
    none = np.zeros_like(still)
    nothing = Kinds(
        still=none, louder=none, other=none, shaking=none, slow=none, spiky=none, notes=tuple(notes)
    )
    if still.all():
        return replace(nothing, still=still)
    base, spiky = allowed(sensor, settings), _spiky(sensor)
    moving = every(w.high > w.low)
    steady = steady_windows(w, sensor.step, still) & moving & ~spiky
    if not still.any():
        return replace(nothing, shaking=steady, spiky=spiky)
    top = np.minimum(_LOUDER * base, np.maximum(loudest(sensor, still), base))
    louder = none.copy()
    for _ in range(_LEVELS):
        left = steady & ~still & ~louder & every(w.variance <= settings.variance_ratio * top**2)
        if left.sum() < _SHARED:
            break
        level = np.maximum(sensor.level(left), base)
        if np.any(level > top):
            break
        found = left & every(w.variance <= settings.variance_ratio * level**2)
        found &= every(w.high - w.low <= settings.range_ratio * level)
        if found.sum() < _SHARED:
            break
        louder |= found
    other = steady & ~still & ~louder & every(w.variance <= top**2)
    shaking = steady & ~still & ~louder & ~other
    slow = ~still & ~louder & ~spiky & moving
    if sensor.quantity == "acceleration":
        slow &= every(w.high - w.low <= _SLOW * gravity_of(sensor, still))
    return replace(
        nothing,
        still=still | louder,
        louder=louder,
        other=other,
        shaking=shaking,
        slow=slow,
        spiky=spiky,
    )


def steady_windows(w: Windows, step: Array, still: Flags) -> Flags:
    """Windows that are not still and have a neighbour of the same mean and variance, as far as
    these tell."""
    one = np.flatnonzero(~(still[1:] & still[:-1]) & (np.diff(w.run) == 0))
    two, least = one + 1, np.square(step) / 12.0
    before, after = w.variance[one] + least, w.variance[two] + least
    apart = np.square(w.mean[two] - w.mean[one]) * w.samples
    pair = every(apart <= _ALIKE**2 * (before + after))
    pair &= every((before <= _ALIKE * after) & (after <= _ALIKE * before))
    steady = np.zeros_like(still)
    steady[one[pair]] = steady[two[pair]] = True
    return steady & ~still


def _spiky(sensor: Sensor) -> Flags:
    """Windows in which one sample alone is far away, on every axis that shows it.

    One outlier of height h among n samples has a variance of h²/n, noise 2.5 h²/n or more, and a
    motion some h²/12.
    """
    w = sensor.windows
    if sensor.quantity != "acceleration" or w.samples < 20 or not w.start.size:
        return np.zeros(w.start.size, dtype=np.bool_)
    reach = w.high - w.low
    far = reach > _OUTLIER * gravity_of(sensor, np.ones(w.start.size, dtype=np.bool_))
    lone = w.variance * w.samples <= 1.6 * reach**2
    return np.asarray(some(far) & every(~far | lone))


Reason = Literal["", "too short", "turning", "vibrating", "dropouts", "other noise"]

_LISTED = 4  # windows of a refused stretch, at least
_MOTION = 0.3  # share of gravity: what varies by more is a motion, and no candidate


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


def with_refused(
    found: list[Candidate], sensor: Sensor, kinds: Kinds, settings: StillSettings
) -> list[Candidate]:
    """With the stretches that one accelerometer's windows refuse, where nothing else is known.

    They take the place of what was too short in them. Both lists are in order of time.
    """
    w = sensor.windows
    gravity = gravity_of(sensor, np.ones_like(kinds.still))
    looked: tuple[tuple[Reason, Flags, Flags], ...] = (
        ("dropouts", kinds.still | kinds.spiky, kinds.spiky),
        ("vibrating", kinds.shaking, kinds.shaking),
        ("other noise", kinds.other, kinds.other),
        ("turning", kinds.still | kinds.slow, kinds.slow),
    )
    for reason, flags, needed in looked:
        free = flags & ~_overlapped(w.start, w.stop, [c for c in found if c.reason != "too short"])
        runs = [(a, b) for a, b in _runs(w, free) if b - a >= _LISTED and needed[a:b].any()]
        new = [_of_windows(w, a, b, reason) for a, b in runs]
        new = [c for c in new if c.length >= settings.shortest and c.noise <= _MOTION * gravity]
        short = np.array([c.reason == "too short" for c in found], dtype=np.bool_)
        drop = short & _overlapped([c.start for c in found], [c.stop for c in found], new)
        kept = [c for c, gone in zip(found, drop, strict=True) if not gone]
        found = sorted([*kept, *new], key=lambda c: c.start)
    return found


def _overlapped(
    start: Array | list[float], stop: Array | list[float], others: list[Candidate]
) -> Flags:
    """Which intervals overlap one of some candidates, which are in order and apart."""
    if not others or not len(start):
        return np.zeros(len(start), dtype=np.bool_)
    begin, end = np.array([[c.start, c.stop] for c in others]).T
    at = np.searchsorted(end, start, side="right")
    near = np.minimum(at, len(others) - 1)
    return np.asarray((at < len(others)) & (begin[near] < np.asarray(stop)))


def _runs(w: Windows, flags: Flags) -> list[tuple[int, int]]:
    """(from, to) of flagged windows that follow one another."""
    chosen = np.flatnonzero(flags)
    if not chosen.size:
        return []
    apart = (np.diff(chosen) > 1) | (np.diff(w.run[chosen]) != 0)
    parts = np.split(chosen, np.flatnonzero(apart) + 1)
    return [(int(part[0]), int(part[-1]) + 1) for part in parts]


def _of_windows(w: Windows, a: int, b: int, reason: Reason) -> Candidate:
    noise = float(np.sqrt(w.variance[a:b].mean(axis=0)).max())
    drift = float(np.ptp(w.mean[a:b], axis=0).max())
    return Candidate(float(w.start[a]), float(w.stop[b - 1]), drift, noise, reason)
