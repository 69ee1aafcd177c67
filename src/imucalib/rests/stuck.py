"""Axes whose reading stands still where a live one could not: dead, held, or at a limit.

An axis that repeats one number passes for the quietest rest there is. Two things tell it from a
live one. Noise of σ steps leaves a sample within one step with the chance erf(1 / (2√2 σ)), which a
stretch of n samples has to the n-th power. And gravity that moves on the other axes, with the
jolts that this takes, moves every axis by more than one step.

An axis that is held but keeps its noise repeats nothing: it stays at one mean, while the size of
gravity, which no posture changes, does not stay.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Flags, Index
from imucalib.rests.stillness import Sensor, StillSettings, allowed, every, some
from imucalib.rests.windows import COLUMNS, Windows
from imucalib.units import STANDARD_GRAVITY

#: Chance up to which noise has not done it: e^-60, for samples of a filter are not independent.
_NATS = 60.0
#: Noise in steps from which the resolution shows it.
_SHOWN = 0.5
#: Seconds at least, and share of gravity by which another axis moves meanwhile.
_SECONDS, _MOVED = 60.0, 0.2
_FAR, _ENDS = _MOVED * STANDARD_GRAVITY, 2
#: Noise of an axis that is still, and steps of its mean from window to window, in its own noise.
_CALM, _ON = 3.0, 2.0
#: Share of gravity from which on a limit is beyond every rest, whatever the bias.
_BEYOND = 1.1


@dataclass(frozen=True)
class Stuck:
    """windows : (m,) in which an axis is stuck, or was within a window; words : of each axis"""

    windows: Flags
    words: tuple[str, ...] = ()


def stuck(sensor: Sensor) -> Stuck:
    """Stretches of windows in which an axis repeats one number while it should not. At the end of
    the recording's own range that is clipping, see `limits`."""
    w = sensor.windows
    found = np.zeros(w.start.size, dtype=np.bool_)
    constant = w.high == w.low
    frozen = every(constant)
    words = []
    for axis in np.flatnonzero((constant & ~frozen[:, None]).any(axis=0)):
        dead = _dead(sensor, int(axis), constant[:, axis], frozen)
        if dead.any():
            words.append(_words(w, int(axis), dead, sensor.rate))
            found |= dead
    while True:  # what one held axis makes of gravity's size is no sign of the others
        each = [_held(sensor, axis, found) for axis in range(w.mean.shape[1])]
        most = int(np.argmax([held.sum() for held in each]))
        if not each[most].any():
            break
        words.append(_held_words(w, most, each[most], sensor.rate))
        found |= each[most]
    beside = np.append(False, found[:-1]) | np.append(found[1:], False)
    return Stuck(found | beside, tuple(words))


def _dead(sensor: Sensor, axis: int, constant: Flags, frozen: Flags) -> Flags:
    """frozen : (m,) windows in which all axes stand still, as asleep"""
    w, value = sensor.windows, sensor.windows.high[:, axis]
    joined = constant[1:] & constant[:-1] & (value[1:] == value[:-1])
    starts = np.flatnonzero(np.append(True, ~joined)).astype(np.intp)
    count = np.diff(starts, append=constant.size)
    dead = _moved(w, axis, starts) & (count * w.samples >= _SECONDS * sensor.rate)
    step, noise = float(sensor.step[axis]), float(sensor.noise[axis])
    if step > 0.0 and noise >= _SHOWN * step:
        stays = math.log(math.erf(0.5 * step / (math.sqrt(2.0) * noise)))
        alone = np.add.reduceat((~frozen).astype(np.float64), starts) * w.samples
        ends = (value == value.max()) | (value == w.low[:, axis].min())
        dead |= (-alone * stays > _NATS) & ~ends[starts]
    return np.asarray(constant & np.repeat(dead, count))


def _held(sensor: Sensor, axis: int, known: Flags) -> Flags:
    """Stretches in which an axis keeps its mean and its noise, through all that moves the others:
    what is still there has a size that gravity has not."""
    w, noise = sensor.windows, np.maximum(sensor.noise, sensor.step)
    calm = (w.variance <= (_CALM * noise) ** 2) & ~known[:, None]
    value, size = w.mean[:, axis], np.linalg.norm(w.mean, axis=1)
    joined = calm[1:, axis] & calm[:-1, axis]
    joined &= np.abs(np.diff(value)) <= _ON * noise[axis]
    starts = np.flatnonzero(np.append(True, ~joined)).astype(np.intp)
    count = np.diff(starts, append=value.size)
    still = every(calm)
    largest = np.maximum.reduceat(np.where(still, size, -np.inf), starts)
    smallest = np.minimum.reduceat(np.where(still, size, np.inf), starts)
    long = count * w.samples >= _SECONDS * sensor.rate
    held = np.repeat(long & (largest - smallest > _FAR), count)
    return np.asarray(held & ~known)


def _moved(w: Windows, axis: int, starts: Index) -> Flags:
    """Whether another axis moves far within each stretch, by more than the motion that may reach
    into its first and last window with a sample or two."""
    others = [k for k in range(w.high.shape[1]) if k != axis]
    mean, far = w.mean[:, others], some(w.high[:, others] - w.low[:, others] > _FAR)
    reach = np.maximum.reduceat(mean, starts) - np.minimum.reduceat(mean, starts)
    return np.asarray(some(reach > _FAR) | (np.add.reduceat(far.astype(np.intp), starts) > _ENDS))


def _words(w: Windows, axis: int, dead: Flags, rate: float) -> str:
    values = np.unique(w.high[dead, axis])
    # A converter's zero may have a sign, which is no news.
    value = f"{values[0] / STANDARD_GRAVITY + 0.0:.3g} g" if values.size == 1 else "one number"
    return (
        f"{'xyz'[axis]} repeats {value} {_when(w, dead, rate)}, while it should move: "
        "stuck, or at a limit; left out of the rests"
    )


def _held_words(w: Windows, axis: int, held: Flags, rate: float) -> str:
    value = float(np.median(w.mean[held, axis])) / STANDARD_GRAVITY
    return (
        f"{'xyz'[axis]} stays at {value:.3g} g {_when(w, held, rate)}, whatever the others do: "
        "it is not its own reading; left out of the rests"
    )


def _when(w: Windows, some: Flags, rate: float) -> str:
    seconds = float(some.sum()) * w.samples / rate
    long = f"{seconds / 3600.0:.2g} h" if seconds >= 3600.0 else f"{seconds / 60.0:.2g} min"
    return f"for {long} from {float(w.start[int(np.argmax(some))]) / 3600.0:.2f} h on"


def without(sensor: Sensor, dead: Stuck) -> Sensor:
    """The sensor with the windows in which no axis is stuck."""
    if not dead.windows.any():
        return sensor
    live, w = ~dead.windows, sensor.windows
    kept = {name: getattr(w, name)[live] for name in COLUMNS}
    return replace(sensor, windows=replace(w, **kept))


def limits(sensor: Sensor, settings: StillSettings) -> tuple[str, ...]:
    """Axes that stand at the end of their range at rest, in words."""
    w, found = sensor.windows, []
    if not sensor.fine:
        return ()
    constant = w.high == w.low
    quiet = every(w.variance <= settings.variance_ratio * allowed(sensor, settings) ** 2)
    single = constant & ~every(constant)[:, None] & quiet[:, None]
    for axis, name in enumerate("xyz"[: constant.shape[1]]):
        for value, word in ((w.high[:, axis].max(), "above"), (w.low[:, axis].min(), "below")):
            size = float(value) / STANDARD_GRAVITY
            at = int((single[:, axis] & (w.high[:, axis] == value)).sum())
            if at and abs(size) < _BEYOND:
                found.append(
                    f"{name} reads nothing {word} {size:.3g} g: {at} windows at rest stand at "
                    "that limit and are left out; what lies beyond it no calibration brings back"
                )
    return tuple(found)
