"""What single chips of an array ask of its user: those that move, and those that are noisy."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.estimate.left import NOISY
from imucalib.calibrators.array.loop.closed_loop import MotionLoop
from imucalib.calibrators.array.loop.terms import typical_of
from imucalib.calibrators.array.loop.words import size_in_words
from imucalib.calibrators.array.rests import RestFit
from imucalib.estimators.array.noise import SensorNoise
from imucalib.units import DEG

_COUNTS = 0.5  # of an effect's typical size, from which it asks for something to be done


def advice(loop: MotionLoop, rests: RestFit) -> tuple[str, ...]:
    """IMUs with an effect of their own, and chips that are noisier in motion than their neighbours,
    with what they are at rest."""
    a, g = loop.final.noise
    imus = loop.final.setup.imus
    return (
        *_alone(loop),
        *_noisy(imus, "accelerometer", a, rests.noise, (1.0, "m/s²")),
        *_noisy(imus, "gyro", g, rests.gyro_noise, (DEG, "deg/s")),
    )


def _alone(loop: MotionLoop) -> Iterator[str]:
    for term in loop.final.found:
        effect, at, imu = term.name.partition("@")
        remedy = term.effect.remedy
        typical = typical_of(term.effect, len(term.theta))
        counts = float(np.sqrt(np.mean((term.theta / typical) ** 2))) >= _COUNTS
        if at and remedy and counts:
            size = size_in_words(loop.final, term)
            yield f"{imu} alone has {effect} ({size}): {remedy}. It is corrected here."


def _noisy(
    imus: tuple[str, ...], sensor: str, noise: SensorNoise, still: Array, unit: tuple[float, str]
) -> Iterator[str]:
    """noise : in motion; still : (K,), at rest; unit : its size in SI, and its name"""
    for k, imu in enumerate(imus):
        times = float(noise.factor[k] / np.median(np.delete(noise.factor, k)))
        if times < NOISY:
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
