"""What a stretch does as a whole: how far its mean goes, and whether that is a turn.

Neighbouring windows of a slow turn agree, its ends do not. A turn of 0.025 deg/s changes an axis
across gravity by 0.43 mg/s: slower ones are allowed where they stay short of a third of a degree,
and a warm-up may add 0.1 mg a minute to that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.rests.stillness import Sensor
from imucalib.rests.windows import Windows
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
_WITNESSES = 5000  # pairs, about, that it is told from
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
    one = pairs[:: max(1, pairs.size // _WITNESSES)]
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
