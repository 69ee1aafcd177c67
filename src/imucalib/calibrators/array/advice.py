"""What the noise of an array's chips in motion asks of its user."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.loop.closed_loop import MotionLoop
from imucalib.calibrators.array.rests import RestFit
from imucalib.estimators.array.noise import SensorNoise
from imucalib.units import DEG

_NOISY = 2.0  # times the others' noise


def advice(loop: MotionLoop, rests: RestFit) -> tuple[str, ...]:
    """Chips that are noisier in motion than their neighbours, with what they are at rest."""
    a, g = loop.final.noise
    imus = loop.final.setup.imus
    return (
        *_noisy(imus, "accelerometer", a, rests.noise, (1.0, "m/s²")),
        *_noisy(imus, "gyro", g, rests.gyro_noise, (DEG, "deg/s")),
    )


def _noisy(
    imus: tuple[str, ...], sensor: str, noise: SensorNoise, still: Array, unit: tuple[float, str]
) -> Iterator[str]:
    """noise : in motion; still : (K,), at rest; unit : its size in SI, and its name"""
    for k, imu in enumerate(imus):
        times = float(noise.factor[k] / np.median(np.delete(noise.factor, k)))
        if times < _NOISY:
            continue
        own = float(still[k] / np.median(np.delete(still, k)))
        cause = (
            "so is it at rest: exchange the chip" if own > 0.5 * times
            else "not at rest: look for a loose mount or something that vibrates"
        )  # fmt: skip
        size = noise.sigma * noise.factor[k] / unit[0]
        yield (
            f"In motion the {sensor} of {imu} is {times:.1f} times noisier than the others "
            f"({size:.2g} {unit[1]}), {cause}. It counts by that much less."
        )
