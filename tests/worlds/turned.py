"""A sensor that is turned by hand between rests: gravity and rate follow one from the other."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array

G = 9.81
RATE, REST, TURN = 100.0, 2.0, 2.0  # Hz, s, s


def turned(
    turns: int = 6, *, peak: float = 1.0, noise: float = 0.01, seed: int = 3
) -> tuple[Array, Array, Array]:
    """t (n,), acceleration (n, 3) m/s², rate (n, 3) rad/s: a rest, a turn, ..., a rest.

    peak : rad/s of each turn's fastest moment, about an axis across gravity
    """
    rng = np.random.default_rng(seed)
    rest, moving = int(REST * RATE), int(TURN * RATE)
    profile = peak * np.sin(np.pi * (np.arange(moving) + 0.5) / moving) ** 2
    up = np.array([0.0, 0.0, 1.0])
    gravity, rates = [np.repeat(up[None], rest, axis=0)], [np.zeros((rest, 3))]
    for _ in range(turns):
        axis = np.cross(up, rng.normal(size=3))
        axis /= np.linalg.norm(axis)
        angle = np.cumsum(profile)[:, None] / RATE
        # A body that turns about an axis across gravity sees it turn the other way.
        gravity.append(up * np.cos(angle) - np.cross(axis, up) * np.sin(angle))
        up = gravity[-1][-1]
        rates.append(profile[:, None] * axis)
        gravity.append(np.repeat(up[None], rest, axis=0))
        rates.append(np.zeros((rest, 3)))
    acc = G * np.concatenate(gravity)
    rate = np.concatenate(rates) + np.array([0.004, -0.003, 0.002])
    acc += rng.normal(0.0, noise, acc.shape)
    rate += rng.normal(0.0, 0.1 * noise, rate.shape)
    return np.arange(len(acc)) / RATE, acc, rate
