"""Noise that is not as modelled: heavy tails, growth with the rate, one noisy IMU, memory."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.estimators.array.noise import SensorNoise, Squares, log_density, power_of_each, scaled


@dataclass(frozen=True)
class NoiseTest:
    """evidence : nats of the likelihood ratio; strength : its root, in standard deviations"""

    name: str
    driver: str
    evidence: float
    strength: float


def noise_tests(state: ArrayState) -> tuple[NoiseTest, ...]:
    """All tests of both kinds of sensor at a fitted state."""
    a, g, speed = state.squares()
    tests = []
    for sensor, square, noise in (
        ("accelerometer", a, state.noise[0]),
        ("gyroscope", g, state.noise[1]),
    ):
        tests += _shapes(sensor, square, speed, noise)
        tests += _each(sensor, square, speed, noise, state.setup.imus)
        rho, n = memory(state, gyro=sensor == "gyroscope")
        tests.append(
            _test(f"{sensor} noise correlated in time", "time", 0.5 * n * max(rho, 0.0) ** 2)
        )
    return tuple(tests)


def best_of_noise(tests: int, rng: np.random.Generator, draws: int) -> Array:
    """(draws,) the best evidence of as many tests on noise that is as modelled."""
    half = np.maximum(rng.standard_normal((tests, draws)), 0.0)
    return np.asarray(0.5 * (half**2).max(axis=0))


def _test(name: str, driver: str, evidence: float) -> NoiseTest:
    return NoiseTest(name, driver, evidence, float(np.sqrt(2.0 * max(evidence, 0.0))))


def _shapes(sensor: str, square: Squares, speed: Array, noise: SensorNoise) -> list[NoiseTest]:
    """Tails, and growth with the rate, where they are not in the noise already."""
    now = scaled(noise, square, speed)
    level = float(log_density(now, square, speed).sum())
    found = []
    if not np.isfinite(noise.freedom):
        tails = [replace(now, freedom=nu) for nu in (5.0, 15.0, 50.0)]
        found.append((f"{sensor} noise with heavy tails", "", tails))
    if noise.growth == 0.0:
        unit = 1.0 / max(float(np.median(speed)), 1e-9)
        grown = [replace(now, growth=c * unit) for c in (0.3, 1.0, 3.0)]
        found.append((f"{sensor} noise growing with the rate", "|ω|", grown))
    return [
        _test(name, driver, max(0.0, *(
            float(log_density(scaled(x, square, speed), square, speed).sum()) - level
            for x in options
        )))
        for name, driver, options in found
    ]  # fmt: skip


def _each(
    sensor: str, square: Squares, speed: Array, noise: SensorNoise, imus: tuple[str, ...]
) -> list[NoiseTest]:
    """One IMU that is noisier than the others: likelihood ratio of two variances against one."""
    own, found = power_of_each(noise, square, speed), []
    every = len(square.length) * square.numbers
    for k, imu in enumerate(imus):
        n, rest = float(every[k]), float(np.delete(every, k).sum())
        one, two = float(own[k]), max(float(np.delete(own, k).mean()), 1e-300)
        both = (n * one + rest * two) / (n + rest)
        gain = 0.5 * (n * np.log(both / max(one, 1e-300)) + rest * np.log(both / two))
        found.append(_test(f"{sensor} noise of {imu}", imu, float(gain) if one > two else 0.0))
    return found


def memory(state: ArrayState, *, gyro: bool) -> tuple[float, int]:
    """Correlation of the weighted residuals of consecutive samples, and the number of pairs."""
    inner, off = state.setup.inner, state.sampled.off
    values = off.rate if gyro else off.acceleration
    weight = state.sampled.weights.rate if gyro else state.sampled.weights.acceleration
    white = (values * np.sqrt(weight)[..., None])[inner]
    together = np.diff(state.setup.t[inner]) < 1.5 * state.setup.interval
    pairs = np.flatnonzero((np.diff(inner) == 1) & together)
    if len(pairs) < 10:
        return 0.0, 0
    product = float(np.sum(white[pairs] * white[pairs + 1]))
    power = float(np.sum(white[pairs] ** 2) + np.sum(white[pairs + 1] ** 2)) / 2.0
    k = white.shape[1]
    # The motion takes its share of the numbers out of every sample.
    return product / max(power, 1e-300), (3 * (k - 2) if not gyro else 3 * (k - 1)) * len(pairs)


def shared_by_neighbours(state: ArrayState, *, gyro: bool) -> float:
    """How many times fewer samples noise with memory is worth, one where none is seen."""
    rho, n = memory(state, gyro=gyro)
    if n == 0 or rho * np.sqrt(n) < 2.5:
        return 1.0
    rho = min(rho, 0.95)
    return float((1.0 + rho) / (1.0 - rho))
