"""Which windows of one sensor are still: its own noise first, then a test of every window."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Flags
from imucalib.errors import UsageError
from imucalib.rests.windows import Windows

_QUIETEST = 0.05  # share of the windows that is surely still in a recording worth calibrating
_FROZEN_SECONDS = 60.0


@dataclass(frozen=True)
class StillSettings:
    """Settings of the detector; the defaults suit bench logs with rests of a few seconds.

    window : s; fewest : samples that a window has at least
    shortest : s, of a segment after trimming; longest : s, a longer rest is split, or None
    trim : windows cut off at both ends of a rest, where the hand still touches
    variance_ratio : variance of a still window over the noise variance, at most, on each axis
    range_ratio : max - min of a still window over the noise standard deviation, at most
    drift_ratio : change of the mean between neighbouring windows, over the noise, at most
    turning : rad/s, deviation of the angular rate that a rest in the hand may have; 0.05 rad/s
        during half a second tilts by 1.4°, which changes a mean norm by less than 1e-4
    sway : m/s², standard deviation of the acceleration that a worn sensor at rest may have beside
        its noise (breathing, slow rolls); 0 for a sensor on a bench
    """

    window: float = 0.5
    fewest: int = 5
    shortest: float = 1.0
    longest: float | None = None
    trim: int = 1
    variance_ratio: float = 4.0
    range_ratio: float = 10.0
    drift_ratio: float = 1.0
    turning: float = 0.05
    sway: float = 0.0

    def __post_init__(self) -> None:
        for name in ("window", "shortest", "variance_ratio", "range_ratio", "drift_ratio"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise UsageError(
                    f"{name} = {value} is not a positive number", where="still settings"
                )


@dataclass(frozen=True)
class Sensor:
    """The windows of one channel of a triad; rate in Hz."""

    triad: str
    quantity: str
    rate: float
    windows: Windows

    @cached_property
    def noise(self) -> Array:
        """(3,) standard deviation of one sample at rest, from the quietest windows.

        The quietest twentieth gives a first value, biased low by the choice; the windows within
        three times its variance, which are chosen by a rule that does not favour low ones, give
        the second and last. Quantisation, step²/12, is the floor.
        """
        # A constant axis is dead or clipped, unless the resolution hides the noise.
        moving = _every(self.windows.high > self.windows.low)
        chosen = moving if self.fine and moving.any() else np.ones_like(moving)
        return self._level(chosen)

    @cached_property
    def fine(self) -> bool:
        """Whether the resolution shows the noise, so that no axis stands still by chance.

        Noise of more than two steps always shows. Below that, a sensor whose quiet windows move
        on all axes is fine, one of which single axes stand still now and then is not.
        """
        w = self.windows
        moving = w.high > w.low
        some, whole = _some(moving), _every(moving)
        live = whole if 2 * whole.sum() > some.sum() else some
        noise = self._level(live if live.any() else np.ones_like(live))
        if np.all(noise > 2.0 * self._step):
            return True
        quiet = _every(w.variance <= (3.0 * self._step) ** 2)
        extreme = _some(~moving & _at_extreme(w))
        return bool((quiet & whole).sum() > (quiet & some & ~whole & ~extreme).sum())

    @property
    def _step(self) -> Array:
        return np.where(np.isfinite(self.windows.finest), self.windows.finest, 0.0)

    def _level(self, chosen: Flags) -> Array:
        """Standard deviation at rest, from the quietest of the chosen windows."""
        variance, floor = self.windows.variance, self._step**2 / 12.0
        total = np.where(chosen, variance.sum(axis=1), np.inf)
        inside = total <= np.quantile(total[chosen], _QUIETEST)
        level = np.zeros(variance.shape[1])
        for turn in range(4):
            if turn:
                level = np.maximum(level, floor)
                inside = chosen & _every(variance <= 3.0 * level)
            if inside.any():  # axis by axis: the windows of weeks are large
                level = np.array([np.median(axis[inside]) for axis in variance.T])
        return np.asarray(np.sqrt(np.maximum(level, floor)))


def judge(
    sensor: Sensor, settings: StillSettings
) -> tuple[list[tuple[float, float]], Flags, list[str]]:
    """Still spans (start, stop) in s, the still windows, and what was left out."""
    still, notes = still_windows(sensor, settings)
    return _spans(sensor.windows, still, _allowed(sensor, settings), settings), still, notes


def _allowed(sensor: Sensor, settings: StillSettings) -> Array:
    """(3,) standard deviation that a sensor at rest may have."""
    if sensor.quantity == "angular_rate":
        least = settings.turning / np.sqrt(settings.variance_ratio)
        return np.asarray(np.maximum(sensor.noise, least))
    return np.asarray(np.hypot(sensor.noise, settings.sway))


def still_windows(sensor: Sensor, settings: StillSettings) -> tuple[Flags, list[str]]:
    """The still windows, and what was left out."""
    w, noise = sensor.windows, _allowed(sensor, settings)
    quiet = _every(w.variance <= settings.variance_ratio * noise**2)
    quiet &= _every(w.high - w.low <= settings.range_ratio * noise)
    frozen, clipped = _frozen(sensor), _clipped(sensor)
    name = f"{sensor.triad}/{sensor.quantity}"
    notes = []
    for flags, word in ((frozen, "frozen"), (clipped, "clipped")):
        if (flags & quiet).any():
            seconds = float((flags & quiet).sum()) * w.samples / sensor.rate
            notes.append(f"{name}: {seconds:.4g} s of {word} samples left out of the rests")
    return quiet & ~frozen & ~clipped, notes


def _frozen(sensor: Sensor) -> Flags:
    """Windows in which no axis ever changes, where the noise says that it would.

    A sensor whose noise is far below its resolution repeats itself at rest; of such a one only
    a constancy of a minute counts as a dead or sleeping sensor.
    """
    w = sensor.windows
    constant = _every(w.high == w.low)
    if sensor.fine:
        # The window before or after one that is frozen through and through is so in part.
        along = np.diff(w.run) == 0
        after = np.append(False, constant[:-1] & along)
        return np.asarray(constant | after | np.append(constant[1:] & along, False))
    same = constant & np.append(False, _every(w.mean[1:] == w.mean[:-1]))
    starts = np.flatnonzero(~same)
    lengths = np.diff(starts, append=same.size)
    needed = _FROZEN_SECONDS * sensor.rate / w.samples
    lead = np.full(starts[0] if starts.size else same.size, 0)
    long = np.concatenate([lead, np.repeat(lengths, lengths)]) >= needed
    return np.asarray(constant & long)


def _clipped(sensor: Sensor) -> Flags:
    """Windows in which one axis stands at its extreme of the whole recording while others move."""
    w = sensor.windows
    constant = w.high == w.low
    clipped = _some(constant & _at_extreme(w)) & ~_every(constant)
    return np.asarray(clipped & sensor.fine)


def _every(flags: Flags) -> Flags:
    """All of each row, column by column: rows of three are slow to reduce."""
    return np.asarray(reduce(np.logical_and, flags.T))


def _some(flags: Flags) -> Flags:
    return np.asarray(reduce(np.logical_or, flags.T))


def _at_extreme(w: Windows) -> Flags:
    return np.asarray((w.high == w.high.max(axis=0)) | (w.low == w.low.min(axis=0)))


def _spans(
    w: Windows, still: Flags, noise: Array, settings: StillSettings
) -> list[tuple[float, float]]:
    """Joined, trimmed and split still windows, as times of their first and last sample."""
    chosen = np.flatnonzero(still)
    if chosen.size == 0:
        return []
    change = np.abs(np.diff(w.mean[chosen], axis=0))
    limit = settings.drift_ratio * noise + 6.0 * noise * np.sqrt(2.0 / w.samples)
    together = (np.diff(chosen) == 1) & (np.diff(w.run[chosen]) == 0)
    together &= _every(change <= limit)
    edges = np.flatnonzero(~together) + 1
    spans = []
    for group in np.split(chosen, edges):
        inner = group[settings.trim : group.size - settings.trim] if settings.trim else group
        for part in _parts(inner, w, settings.longest):
            spans.append((float(w.start[part[0]]), float(w.stop[part[-1]])))
    return spans


def _parts(group: NDArray[np.intp], w: Windows, longest: float | None) -> list[NDArray[np.intp]]:
    if group.size == 0:
        return []
    length = float(w.stop[group[-1]] - w.start[group[0]])
    pieces = 1 if longest is None else max(1, int(np.ceil(length / longest)))
    return [p for p in np.array_split(group, pieces) if p.size]
