"""What rounding to a step leaves of a mean.

Rounding is a saw-tooth of what is rounded. Noise before it takes its harmonics down, the k-th by
exp(-2 (π k s / q)²), s the noise and q the step: noise of half a step leaves nothing (Widrow
and Kollar, Quantization Noise, 2008, chapter 4).
"""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array


def rounding_sd(noise: Array, step: Array, *, alike: bool = False) -> Array:
    """Standard deviation of what rounding leaves of the mean of however many readings of one value.

    noise : of readings as they were rounded
    step : between readings, 0 where there is none
    alike : whether all rests read the same: between two steps rounding alone makes noise of a half
    """
    before = np.maximum(noise**2 - step**2 / (4.0 if alike else 12.0), 0.0)
    ratio = 4.0 * np.pi**2 * before / np.maximum(step, 1e-100) ** 2
    k = np.arange(1.0, 41.0)
    harmonics = np.exp(-ratio[..., None] * k**2) / k**2
    return np.asarray(step * np.sqrt(harmonics.sum(axis=-1) / 2.0) / np.pi)
