"""Noise of gyros that the motion follows, judged by what gyros differ by.

A residual over the root of the share that the motion leaves of it says how noisy a gyro is, as long
as something is left. Of few gyros one that counts more leaves less, is taken for quieter and counts
more still: one whose errors were the least before any effect was known kept 2 % of its noise for
good. Differences between gyros hold no motion, however it was weighed (Gray and Allan 1974, the
three-cornered hat).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.estimators.array.noise import SensorNoise
from imucalib.estimators.array.samples import Sampled

#: Share of a gyro's errors below which the motion follows it more than all else together.
_FOLLOWED = 0.5
_FEWEST = 3
_MEDIAN = 2.36597  # of the squared length of three numbers of variance one


def not_followed(noise: SensorNoise, sampled: Sampled, rows: Index) -> SensorNoise:
    """The noise of gyros, in which one that the motion follows is no quieter than the gyros'
    differences at some samples say."""
    share = np.mean(sampled.kept[1].share[rows], axis=0)
    followed = (share < _FOLLOWED) & (noise.factor < 1.0)
    if not followed.any() or len(share) < _FEWEST:
        return noise
    own = power_apart(sampled.off.rate[rows])
    least = np.where(followed, np.sqrt(own / np.mean(own)), 0.0)
    return replace(noise, factor=np.maximum(noise.factor, least))


def power_apart(off: Array) -> Array:
    """(K,) mean squares of one number of each triad's errors; by medians, which tails do not move.

    off : (T, K, 3) residuals about one motion of all
    """
    count = off.shape[1]
    square = np.sum((off[:, :, None] - off[:, None]) ** 2, axis=3)
    pair = np.median(square, axis=0) / _MEDIAN
    whole = pair.sum() / (2.0 * (count - 1))
    return np.asarray(np.maximum((pair.sum(axis=1) - whole) / (count - 2), 0.0))
