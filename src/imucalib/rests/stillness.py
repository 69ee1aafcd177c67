"""Which windows of one sensor are still: its own noise first, then a test of every window.

A sensor's noise may change in the middle of a recording, with a range, a filter, a machine beside
it. Windows that are steady, neighbour like neighbour, at a noise that many of them share are rests
at that noise; what shakes by more is none, whatever its mean does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, reduce

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.errors import UsageError
from imucalib.rests.windows import Windows

_FEWEST = 5  # samples of a window
#: rad/s, deviation of the angular rate that a rest in the hand may have: during half a second it
#: tilts by 1.4°, which changes a mean norm by less than 1e-4.
_TURNING = 0.05
_FROZEN_SECONDS = 60.0
#: Largest noise of an accelerometer at rest, as a share of gravity: ten times that of the noisiest
#: common ones. Only a resolution of this size hides more. What is above shakes.
_LOUDEST = 0.03
_LOUDEST_STEPS = 2.0
_ZONE = 3  # stretches of one number that make a gyroscope's dead zone
_WITNESSES = 5000  # windows that the size of gravity is estimated from
_POSTURES = 5  # different constant readings of gravity's size that a dead sensor does not have
_SINGLE = 3  # windows in which one axis stands still beside others, as in none of a live sensor
_SIZE = 0.2  # share of gravity by which the size of a reading at rest may be off
_LOUDER = 5.0  # times the quietest noise that a sensor's own noise may grow to
_LEVELS = 2  # louder noises that are looked for
_SHARED = 10  # windows that must share a louder noise
_ALIKE = 4.0  # ratio of the variances of neighbours, at most; standard errors between their means
_SLOW = 0.03  # share of gravity that a slow turn may change the reading by in a window
_OUTLIER = 0.1  # share of gravity by which a dropout differs from the samples around it


@dataclass(frozen=True)
class StillSettings:
    """Settings of the detector; the defaults suit bench logs with rests of a second and more.

    window : s, at most half of `shortest` is used
    shortest : s, of a rest
    variance_ratio : variance of a still window over the noise variance, at most, on each axis
    range_ratio : max - min of a still window over the noise standard deviation, at most
    sway : m/s², standard deviation of the acceleration that a worn sensor at rest may have beside
        its noise (breathing, slow rolls); 0 for a sensor on a bench
    quietest : share of the windows that is surely still in a recording worth calibrating
    """

    window: float = 0.5
    shortest: float = 1.0
    variance_ratio: float = 4.0
    range_ratio: float = 10.0
    sway: float = 0.0
    quietest: float = 0.01

    def __post_init__(self) -> None:
        if not (np.isfinite(self.shortest) and self.shortest > 0):
            raise UsageError(f"shortest = {self.shortest} is not a positive number")

    def samples(self, rate: float) -> int:
        """Samples of a window at a rate (Hz): two windows fit into the shortest rest."""
        return max(_FEWEST, round(min(self.window, 0.5 * self.shortest) * rate))


@dataclass(frozen=True)
class Sensor:
    """The windows of one channel of a triad; rate in Hz; settings of the detector."""

    triad: str
    quantity: str
    rate: float
    windows: Windows
    settings: StillSettings

    @property
    def name(self) -> str:
        return f"{self.triad}/{self.quantity}"

    @property
    def turns(self) -> bool:
        """Whether it is a gyroscope."""
        return self.quantity == "angular_rate"

    @cached_property
    def noise(self) -> Array:
        """(3,) standard deviation of one sample at rest, from the quietest windows.

        The quietest few give a first value, biased low by the choice; the windows within
        three times its variance, which are chosen by a rule that does not favour low ones, give
        the second and last. Quantisation, step²/12, is the floor.
        """
        # A constant axis is dead or clipped, unless the resolution hides the noise.
        moving = all_axes(self.windows.high > self.windows.low)
        chosen = moving if self.fine and moving.any() else np.ones_like(moving)
        return self.level(chosen | self.zone)

    @cached_property
    def zone(self) -> Flags:
        """Windows in which a gyroscope reads one number as in other stretches before, or zero: it
        has a dead zone, and is no more frozen than any gyroscope at rest."""
        w = self.windows
        constant = all_axes(w.high == w.low)
        if not self.turns or not constant.any():
            return np.zeros_like(constant)
        rows = np.flatnonzero(constant)
        _, kind = np.unique(w.mean[rows], axis=0, return_inverse=True)
        begins = np.append(True, (np.diff(rows) > 1) | (np.diff(kind.ravel()) != 0))
        if len(begins) == len(constant) and begins.sum() == 1:  # a dead one is no witness of motion
            return constant
        if np.any(self.level(~constant) > _TURNING):  # else it would never rest
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
        either, whole = any_axis(moving), all_axes(moving)
        live = whole if 2 * whole.sum() > either.sum() else either
        noise = self.level(live if live.any() else np.ones_like(live))
        quiet = all_axes(w.variance <= (3.0 * self.step) ** 2)
        alone = quiet & either & ~whole
        shown = bool(np.all(noise > 2.0 * self.step))
        if (shown or alone.sum() >= _SINGLE) and self._hidden(noise):
            return False
        extreme = any_axis(~moving & _at_extreme(w))
        return shown or bool((quiet & whole).sum() > (alone & ~extreme).sum())

    def _hidden(self, noise: Array) -> bool:
        """Whether more postures stand still to the step than pairs of windows share the noise.

        What moves is then motion: it comes in all sizes, and seldom twice with one mean.
        """
        w = self.windows
        stepped = self._postures(all_axes(w.high == w.low))
        postures = np.unique(w.mean[stepped], axis=0)
        if not len(postures) or np.any(noise > self.loudest(stepped)):
            return len(postures) > 0
        live = all_axes((w.variance <= 3.0 * noise**2) & (w.high > w.low))
        pairs = live[1:] & live[:-1] & w.following
        pairs &= all_axes(np.abs(np.diff(w.mean, axis=0)) <= noise)
        return len(postures) > int(pairs.sum())

    @property
    def step(self) -> Array:
        """(3,) resolution, 0 where it is not known."""
        return np.where(np.isfinite(self.windows.finest), self.windows.finest, 0.0)

    def level(self, chosen: Flags) -> Array:
        """Standard deviation at rest, from the quietest of the chosen windows."""
        variance, floor = self.windows.variance, self.step**2 / 12.0
        total = np.where(chosen, variance.sum(axis=1), np.inf)
        inside = total <= np.quantile(total[chosen], self.settings.quietest)
        level = np.zeros(variance.shape[1])
        for turn in range(4):
            if turn:
                level = np.maximum(level, floor)
                inside = chosen & all_axes(variance <= 3.0 * level)
            if inside.any():  # axis by axis: the windows of weeks are large
                level = np.array([np.median(axis[inside]) for axis in variance.T])
        return np.asarray(np.sqrt(np.maximum(level, floor)))

    @property
    def allowed(self) -> Array:
        """(3,) standard deviation that it may have at rest."""
        if self.turns:
            least = _TURNING / np.sqrt(self.settings.variance_ratio)
            return np.asarray(np.maximum(self.noise, least))
        return np.asarray(np.hypot(self.noise, self.settings.sway))

    def gravity(self, chosen: Flags | None = None) -> float:
        """Size of the mean reading in some windows or all: gravity, in the channel's own unit."""
        mean = self.windows.mean
        found = np.arange(len(mean)) if chosen is None else np.flatnonzero(chosen)
        few = found[:: max(1, found.size // _WITNESSES)]
        return float(np.median(np.linalg.norm(mean[few], axis=1)))

    def loudest(self, chosen: Flags) -> Array:
        """(3,) largest standard deviation that can be its own noise at rest."""
        if self.turns:
            return np.full(3, np.inf)
        return np.maximum(_LOUDEST * self.gravity(chosen), _LOUDEST_STEPS * self.step)

    def quieter_than(self, level: Array) -> Flags:
        """Windows whose variance and range a noise of some standard deviation explains."""
        w = self.windows
        quiet = all_axes(w.variance <= self.settings.variance_ratio * level**2)
        return quiet & all_axes(w.high - w.low <= self.settings.range_ratio * level)

    @property
    def frozen(self) -> Flags:
        """Windows in which no axis ever changes, where the noise says that it would.

        A sensor whose noise is far below its resolution repeats itself at rest; of such a one only
        a constancy of a minute counts as a dead or sleeping sensor, and not where postures of their
        own last as long.
        """
        w = self.windows
        constant = all_axes(w.high == w.low) & ~self.zone
        if self.fine:
            # The window before or after one that is frozen through and through is so in part.
            after = np.append(False, constant[:-1] & w.following)
            return np.asarray(constant | after | np.append(constant[1:] & w.following, False))
        same = constant & np.append(False, all_axes(w.mean[1:] == w.mean[:-1]))
        starts = np.flatnonzero(~same)
        lengths = np.diff(starts, append=same.size)
        needed = _FROZEN_SECONDS * self.rate / w.samples
        lead = np.full(starts[0] if starts.size else same.size, 0)
        long = constant & (np.concatenate([lead, np.repeat(lengths, lengths)]) >= needed)
        return np.asarray(long & ~self._postures(long))

    def _postures(self, constant: Flags) -> Flags:
        """Of windows that read one step of each axis, those that read gravity's size, where they
        read more directions of it than a dead sensor does; else none."""
        if self.turns or not constant.any():
            return np.zeros_like(constant)
        mean, gravity = self.windows.mean, self.gravity()
        found = constant & (np.abs(np.linalg.norm(mean, axis=1) - gravity) <= _SIZE * gravity)
        return np.asarray(found & (len(np.unique(mean[found], axis=0)) >= _POSTURES))

    @property
    def clipped(self) -> Flags:
        """Windows in which one axis stands at its extreme of the whole recording while others
        move."""
        w = self.windows
        constant = w.high == w.low
        return np.asarray(any_axis(constant & _at_extreme(w)) & ~all_axes(constant) & self.fine)


def still_windows(sensor: Sensor) -> tuple[Flags, list[str]]:
    """The still windows, and what was left out."""
    name, w, notes = sensor.name, sensor.windows, []
    quiet = sensor.quieter_than(sensor.allowed)
    bad = {"frozen": sensor.frozen, "clipped": sensor.clipped}
    for word, flags in bad.items():
        if (flags & quiet).any():
            seconds = float((flags & quiet).sum()) * w.samples / sensor.rate
            notes.append(f"{name}: {seconds:.4g} s of {word} samples left out of the rests")
    if sensor.zone.all() and sensor.zone.size:
        notes.append(f"{name}: reads one number throughout: it tells no rest from a turn")
    quiet &= ~bad["frozen"] & ~bad["clipped"]
    if quiet.any() and np.any(sensor.noise > sensor.loudest(quiet)):
        share = float(np.max(sensor.noise)) / sensor.gravity(quiet)
        notes.append(f"{name}: shakes by {1e3 * share:.3g} mg even where it is quietest")
        quiet[:] = False
    return quiet, notes


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


def kinds_of(sensor: Sensor) -> Kinds:
    """The kinds of a sensor's windows."""
    w, ratio = sensor.windows, sensor.settings.variance_ratio
    still, notes = still_windows(sensor)
    none = np.zeros_like(still)
    others = dict.fromkeys(("louder", "other", "shaking", "slow", "spiky"), none)
    kinds = Kinds(still=still, notes=tuple(notes), **others)
    if still.all():
        return kinds
    spiky, moving = _spiky(sensor), all_axes(w.high > w.low)
    steady = _steady(sensor, still) & moving & ~spiky
    if not still.any():
        return replace(kinds, shaking=steady, spiky=spiky)
    base, louder = sensor.allowed, none.copy()
    top = np.minimum(_LOUDER * base, np.maximum(sensor.loudest(still), base))
    for _ in range(_LEVELS):
        rest = steady & ~louder & all_axes(w.variance <= ratio * top**2)
        if rest.sum() < _SHARED:
            break
        level = np.maximum(sensor.level(rest), base)
        found = rest & sensor.quieter_than(level)
        if np.any(level > top) or found.sum() < _SHARED:
            break
        louder |= found
    other = steady & ~louder & all_axes(w.variance <= top**2)
    slow = ~still & ~louder & ~spiky & moving
    if not sensor.turns:
        slow &= all_axes(w.high - w.low <= _SLOW * sensor.gravity(still))
    return replace(
        kinds,
        still=still | louder,
        louder=louder,
        other=other,
        shaking=steady & ~louder & ~other,
        slow=slow,
        spiky=spiky,
    )


def _steady(sensor: Sensor, still: Flags) -> Flags:
    """Windows that are not still and have a neighbour of the same mean and variance, as far as
    these tell."""
    w = sensor.windows
    one = np.flatnonzero(~(still[1:] & still[:-1]) & w.following)
    two, least = one + 1, np.square(sensor.step) / 12.0
    before, after = w.variance[one] + least, w.variance[two] + least
    apart = np.square(w.mean[two] - w.mean[one]) * w.samples
    pair = all_axes(apart <= _ALIKE**2 * (before + after))
    pair &= all_axes((before <= _ALIKE * after) & (after <= _ALIKE * before))
    steady = np.zeros_like(still)
    steady[one[pair]] = steady[two[pair]] = True
    return steady & ~still


def _spiky(sensor: Sensor) -> Flags:
    """Windows in which one sample alone is far away, on every axis that shows it.

    One outlier of height h among n samples has a variance of h²/n, noise 2.5 h²/n or more, and a
    motion some h²/12.
    """
    w = sensor.windows
    if sensor.turns or w.samples < 20 or not w.start.size:
        return np.zeros(w.start.size, dtype=np.bool_)
    reach = w.high - w.low
    far = reach > _OUTLIER * sensor.gravity()
    lone = w.variance * w.samples <= 1.6 * reach**2
    return np.asarray(any_axis(far) & all_axes(~far | lone))


def all_axes(flags: Flags) -> Flags:
    """All of each row, column by column: rows of three are slow to reduce."""
    return np.asarray(reduce(np.logical_and, flags.T))


def any_axis(flags: Flags) -> Flags:
    """Any of each row."""
    return np.asarray(reduce(np.logical_or, flags.T))


def _at_extreme(w: Windows) -> Flags:
    return np.asarray((w.high == w.high.max(axis=0)) | (w.low == w.low.min(axis=0)))
