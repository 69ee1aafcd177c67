"""Which windows of one sensor are still: its own noise first, then a test of every window."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.errors import UsageError
from imucalib.rests.windows import Windows

_FROZEN_SECONDS = 60.0
#: Largest noise of an accelerometer at rest, as a share of gravity: ten times that of the noisiest
#: common ones. Only a resolution of this size hides more. What is above shakes.
_LOUDEST = 0.03
_LOUDEST_STEPS = 2.0
_ZONE = 3  # stretches of one number that make a gyroscope's dead zone
_WITNESSES = 5000  # windows that the size of gravity is told from
_POSTURES = 5  # different constant readings of gravity's size that a dead sensor does not have
_SINGLE = 3  # windows in which one axis stands still beside others, as in none of a live sensor
_SIZE = 0.2  # share of gravity by which the size of a reading at rest may be off


@dataclass(frozen=True)
class StillSettings:
    """Settings of the detector; the defaults suit bench logs with rests of a second and more.

    window : s, at most half of `shortest` is used; fewest : samples that a window has at least
    shortest : s, of a rest; longest : s, a longer rest is split, or None
    trim : windows cut off at both ends of a rest where the samples themselves are not at hand
    variance_ratio : variance of a still window over the noise variance, at most, on each axis
    range_ratio : max - min of a still window over the noise standard deviation, at most
    drift_ratio : change of the mean between neighbouring windows, over the noise, at most
    turning : rad/s, deviation of the angular rate that a rest in the hand may have; 0.05 rad/s
        during half a second tilts by 1.4°, which changes a mean norm by less than 1e-4
    sway : m/s², standard deviation of the acceleration that a worn sensor at rest may have beside
        its noise (breathing, slow rolls); 0 for a sensor on a bench
    quietest : share of the windows that is surely still in a recording worth calibrating
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
    quietest: float = 0.01

    def __post_init__(self) -> None:
        for name in ("window", "shortest", "variance_ratio", "range_ratio", "drift_ratio"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise UsageError(
                    f"{name} = {value} is not a positive number", where="still settings"
                )

    def samples(self, rate: float) -> int:
        """Samples of a window at a rate (Hz): two windows fit into the shortest rest."""
        return max(self.fewest, round(min(self.window, 0.5 * self.shortest) * rate))


@dataclass(frozen=True)
class Sensor:
    """The windows of one channel of a triad; rate in Hz; quietest, turning as in the settings."""

    triad: str
    quantity: str
    rate: float
    windows: Windows
    quietest: float = 0.05
    turning: float = np.inf

    @property
    def name(self) -> str:
        return f"{self.triad}/{self.quantity}"

    @cached_property
    def noise(self) -> Array:
        """(3,) standard deviation of one sample at rest, from the quietest windows.

        The quietest few give a first value, biased low by the choice; the windows within
        three times its variance, which are chosen by a rule that does not favour low ones, give
        the second and last. Quantisation, step²/12, is the floor.
        """
        # A constant axis is dead or clipped, unless the resolution hides the noise.
        moving = every(self.windows.high > self.windows.low)
        chosen = moving if self.fine and moving.any() else np.ones_like(moving)
        return self.level(chosen | self.zone)

    @cached_property
    def zone(self) -> Flags:
        """Windows in which a gyroscope reads one number as in other stretches before, or zero: it
        has a dead zone, and is no more frozen than any gyroscope at rest."""
        w = self.windows
        constant = every(w.high == w.low)
        if self.quantity != "angular_rate" or not constant.any():
            return np.zeros_like(constant)
        rows = np.flatnonzero(constant)
        _, kind = np.unique(w.mean[rows], axis=0, return_inverse=True)
        begins = np.append(True, (np.diff(rows) > 1) | (np.diff(kind.ravel()) != 0))
        if len(begins) == len(constant) and begins.sum() == 1:  # a dead one is no witness of motion
            return constant
        if np.any(self.level(~constant) > self.turning):  # else it would never rest
            return constant
        often = np.bincount(kind.ravel()[begins])[kind.ravel()] >= _ZONE
        zone = np.zeros_like(constant)
        zone[rows] = often | ~w.mean[rows].any(axis=1)
        return zone

    @cached_property
    def fine(self) -> bool:
        """Whether the resolution shows the noise, so that no axis stands still by chance.

        Noise of more than two steps shows, unless it is motion's. Below that, a sensor whose quiet
        windows move on all axes is fine. One is not of which single axes stand still more often,
        or as well, where posture after posture does: what is held stands still on all axes.
        """
        w = self.windows
        moving = w.high > w.low
        either, whole = some(moving), every(moving)
        live = whole if 2 * whole.sum() > either.sum() else either
        noise = self.level(live if live.any() else np.ones_like(live))
        quiet = every(w.variance <= (3.0 * self.step) ** 2)
        alone = quiet & either & ~whole
        shown = bool(np.all(noise > 2.0 * self.step))
        if (shown or alone.sum() >= _SINGLE) and self._hidden(noise):
            return False
        extreme = some(~moving & _at_extreme(w))
        return shown or bool((quiet & whole).sum() > (alone & ~extreme).sum())

    def _hidden(self, noise: Array) -> bool:
        """Whether more postures stand still to the step than pairs of windows share the noise.

        What moves is then motion: it comes in all sizes, and seldom twice with one mean.
        """
        w = self.windows
        stepped = _postures(self, every(w.high == w.low))
        postures = np.unique(w.mean[stepped], axis=0)
        if not len(postures) or np.any(noise > loudest(self, stepped)):
            return len(postures) > 0
        live = every((w.variance <= 3.0 * noise**2) & (w.high > w.low))
        pairs = live[1:] & live[:-1] & (np.diff(w.run) == 0)
        pairs &= every(np.abs(np.diff(w.mean, axis=0)) <= noise)
        return len(postures) > int(pairs.sum())

    @property
    def step(self) -> Array:
        """(3,) resolution, 0 where it is not known."""
        return np.where(np.isfinite(self.windows.finest), self.windows.finest, 0.0)

    def level(self, chosen: Flags) -> Array:
        """Standard deviation at rest, from the quietest of the chosen windows."""
        variance, floor = self.windows.variance, self.step**2 / 12.0
        total = np.where(chosen, variance.sum(axis=1), np.inf)
        inside = total <= np.quantile(total[chosen], self.quietest)
        level = np.zeros(variance.shape[1])
        for turn in range(4):
            if turn:
                level = np.maximum(level, floor)
                inside = chosen & every(variance <= 3.0 * level)
            if inside.any():  # axis by axis: the windows of weeks are large
                level = np.array([np.median(axis[inside]) for axis in variance.T])
        return np.asarray(np.sqrt(np.maximum(level, floor)))


def allowed(sensor: Sensor, settings: StillSettings) -> Array:
    """(3,) standard deviation that a sensor at rest may have."""
    if sensor.quantity == "angular_rate":
        least = settings.turning / np.sqrt(settings.variance_ratio)
        return np.asarray(np.maximum(sensor.noise, least))
    return np.asarray(np.hypot(sensor.noise, settings.sway))


def still_windows(sensor: Sensor, settings: StillSettings) -> tuple[Flags, list[str]]:
    """The still windows, and what was left out."""
    w, noise = sensor.windows, allowed(sensor, settings)
    quiet = every(w.variance <= settings.variance_ratio * noise**2)
    quiet &= every(w.high - w.low <= settings.range_ratio * noise)
    frozen, clipped = _frozen(sensor), _clipped(sensor)
    name, notes = sensor.name, []
    for flags, word in ((frozen, "frozen"), (clipped, "clipped")):
        if (flags & quiet).any():
            seconds = float((flags & quiet).sum()) * w.samples / sensor.rate
            notes.append(f"{name}: {seconds:.4g} s of {word} samples left out of the rests")
    if sensor.zone.all() and sensor.zone.size:
        notes.append(f"{name}: reads one number throughout: it tells no rest from a turn")
    quiet &= ~frozen & ~clipped
    if quiet.any() and np.any(sensor.noise > loudest(sensor, quiet)):
        share = float(np.max(sensor.noise)) / gravity_of(sensor, quiet)
        notes.append(f"{name}: shakes by {1e3 * share:.3g} mg even where it is quietest")
        quiet[:] = False
    return quiet, notes


def gravity_of(sensor: Sensor, chosen: Flags) -> float:
    """Size of the mean reading in some windows: gravity, in the channel's own unit."""
    found = np.flatnonzero(chosen)
    few = found[:: max(1, found.size // _WITNESSES)]
    return float(np.median(np.linalg.norm(sensor.windows.mean[few], axis=1)))


def loudest(sensor: Sensor, chosen: Flags) -> Array:
    """(3,) largest standard deviation that can be the sensor's own noise at rest."""
    if sensor.quantity != "acceleration":
        return np.full(3, np.inf)
    least = _LOUDEST * gravity_of(sensor, chosen)
    return np.maximum(least, _LOUDEST_STEPS * sensor.step)


def _frozen(sensor: Sensor) -> Flags:
    """Windows in which no axis ever changes, where the noise says that it would.

    A sensor whose noise is far below its resolution repeats itself at rest; of such a one only
    a constancy of a minute counts as a dead or sleeping sensor, and not where postures of their
    own last as long.
    """
    w = sensor.windows
    constant = every(w.high == w.low) & ~sensor.zone
    if sensor.fine:
        # The window before or after one that is frozen through and through is so in part.
        along = np.diff(w.run) == 0
        after = np.append(False, constant[:-1] & along)
        return np.asarray(constant | after | np.append(constant[1:] & along, False))
    same = constant & np.append(False, every(w.mean[1:] == w.mean[:-1]))
    starts = np.flatnonzero(~same)
    lengths = np.diff(starts, append=same.size)
    needed = _FROZEN_SECONDS * sensor.rate / w.samples
    lead = np.full(starts[0] if starts.size else same.size, 0)
    long = np.concatenate([lead, np.repeat(lengths, lengths)]) >= needed
    long &= constant
    return np.asarray(long & ~_postures(sensor, long))


def _postures(sensor: Sensor, constant: Flags) -> Flags:
    """Of windows that read one step of each axis, those that read gravity's size, where they read
    more directions of it than a dead sensor does; else none."""
    if sensor.quantity != "acceleration" or not constant.any():
        return np.zeros_like(constant)
    mean, gravity = sensor.windows.mean, gravity_of(sensor, np.ones_like(constant))
    found = constant & (np.abs(np.linalg.norm(mean, axis=1) - gravity) <= _SIZE * gravity)
    return np.asarray(found & (len(np.unique(mean[found], axis=0)) >= _POSTURES))


def _clipped(sensor: Sensor) -> Flags:
    """Windows in which one axis stands at its extreme of the whole recording while others move."""
    w = sensor.windows
    constant = w.high == w.low
    clipped = some(constant & _at_extreme(w)) & ~every(constant)
    return np.asarray(clipped & sensor.fine)


def every(flags: Flags) -> Flags:
    """All of each row, column by column: rows of three are slow to reduce."""
    return np.asarray(reduce(np.logical_and, flags.T))


def some(flags: Flags) -> Flags:
    """Any of each row."""
    return np.asarray(reduce(np.logical_or, flags.T))


def _at_extreme(w: Windows) -> Flags:
    return np.asarray((w.high == w.high.max(axis=0)) | (w.low == w.low.min(axis=0)))
