"""Candidates for rests, and those that an accelerometer's windows refuse by themselves."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.rests.levels import Kinds
from imucalib.rests.stillness import Sensor, StillSettings, gravity_of
from imucalib.rests.windows import Windows

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
        free = flags & ~_taken(w, [c for c in found if c.reason != "too short"])
        runs = [(a, b) for a, b in _runs(w, free) if b - a >= _LISTED and needed[a:b].any()]
        new = [_of_windows(w, a, b, reason) for a, b in runs]
        new = [
            c for c in new if c.length >= settings.shortest and c.noise <= _MOTION * gravity
        ]  # fmt: skip
        short = np.array([c.reason == "too short" for c in found], dtype=np.bool_)
        drop = short & _overlapped([c.start for c in found], [c.stop for c in found], new)
        kept = [c for c, gone in zip(found, drop, strict=True) if not gone]
        found = sorted([*kept, *new], key=lambda c: c.start)
    return found


def _taken(w: Windows, settled: list[Candidate]) -> Flags:
    return _overlapped(w.start, w.stop, settled)


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
