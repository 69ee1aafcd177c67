"""Still windows of a sensor that belong together, and groups that are pieces of a slow motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.rests.drift import far_apart
from imucalib.rests.levels import Kinds
from imucalib.rests.stillness import Sensor, StillSettings, allowed, every, gravity_of

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
