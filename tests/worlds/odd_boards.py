"""Boards with something that nobody declared, on the logs of `worlds.boards`: by numpy alone.

Each plant changes what one IMU, or a few, read at the true motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from imucalib.recording.recording import Channel, Recording
from worlds.boards import DEG, Array, BoardPlan, Made, Parts, handled, twisted

G = 9.80665
PLAN = BoardPlan(twist_s=25.0, mounting=0.3, gyro_gain=0.005)


@dataclass(frozen=True)
class Moved:
    """The truth: t (n,); rate, spin, force (n, 3) of the origin in board axes; moving (n,)"""

    t: Array
    rate: Array
    spin: Array
    force: Array
    moving: Array

    def felt(self, r: Array) -> Array:
        """(n, 3) specific force at places r (3,) or (n, 3) m that stand still on the board."""
        r = np.broadcast_to(r, self.rate.shape)
        return np.asarray(
            self.force + np.cross(self.rate, np.cross(self.rate, r)) + np.cross(self.spin, r)
        )


@dataclass(frozen=True)
class Planted:
    """felt : (n, 3) force at the package; rate : (n, 3) that its gyro senses; both in board axes,
    before the package's own gains"""

    felt: Array
    rate: Array


#: From the truth, a place (m) and the number of the IMU to what that IMU senses.
Plant = Callable[[Moved, Array, int], Planted]


def plain(m: Moved, r: Array, k: int) -> Planted:
    return Planted(m.felt(r), m.rate)


def flexing(m: Moved, r: Array, k: int) -> Planted:
    """imu3 stands on a spring: 0.1 mm a g across it, 0.03 along it."""
    if k != 3:
        return plain(m, r, k)
    away = 1e-4 / G * m.felt(r) * np.array([0.3, 0.3, 1.0])
    return Planted(m.felt(r + away), m.rate)


def by_rate(m: Moved, r: Array, k: int) -> Planted:
    """imu3 moves outwards with the square of the rate: 0.2 mm at 1000 deg/s."""
    if k != 3:
        return plain(m, r, k)
    share = np.sum(m.rate**2, axis=1) / (1000.0 * DEG) ** 2
    return Planted(m.felt(r + 2e-4 * share[:, None] * np.array([0.6, -0.5, 0.6])), m.rate)


def gyro_drifting(m: Moved, r: Array, k: int) -> Planted:
    """imu2's gyro scale grows by 2 % over the log."""
    if k != 2:
        return plain(m, r, k)
    late = m.t / m.t[-1]
    return Planted(m.felt(r), m.rate * (1.0 + 0.02 * late[:, None]))


def slowed(t: Array, values: Array, tau: float) -> Array:
    """(n, 3) behind a low-pass of the first order, τ in s, at even times t (n,): exact for straight
    lines from sample to sample."""
    from scipy.signal import lfilter

    h = t[1] - t[0]
    kept = np.exp(-h / tau)
    first, second = 1.0 - tau / h * (1.0 - kept), tau / h * (1.0 - kept) - kept
    start = (1.0 - first) * values[:1]
    return np.asarray(lfilter([first, second], [1.0, -kept], values, axis=0, zi=start)[0])


def slow(
    force: float = 0.0, rate: float = 0.0, imus: frozenset[int] = frozenset(range(8))
) -> Plant:
    """Accelerometers and gyros behind low-passes of so many seconds; such a log is made `often`."""

    def plant(m: Moved, r: Array, k: int) -> Planted:
        one = plain(m, r, k)
        if k not in imus:
            return one
        return Planted(
            slowed(m.t, one.felt, force) if force else one.felt,
            slowed(m.t, one.rate, rate) if rate else one.rate,
        )

    return plant


PLANTS: dict[str, Plant] = {
    "flexing": flexing,
    "by rate": by_rate,
    "gyro drifting": gyro_drifting,
}


def odd_log(
    parts: Parts, plant: Plant, plan: BoardPlan, rng: np.random.Generator, often: int = 1
) -> Made:
    """A log of a board of which some IMUs sense something else; often : steps of the truth from
    sample to sample, for what has a memory."""
    fine = replace(plan, hz=often * plan.hz)
    rests, twist = handled(fine, rng), twisted(fine, rng)
    w, spin, force = (np.concatenate(pair) for pair in zip(rests, twist, strict=True))
    t, moving = np.arange(len(w)) / fine.hz, np.arange(len(w)) >= len(rests[0])
    truth, channels = Moved(t, w, spin, force, moving), {}
    t, moving = t[::often], moving[::often]
    n = len(t)
    for i, name in enumerate(parts.names):
        seen = plant(truth, parts.positions[i], i)
        noise = rng.normal(size=(2, n, 3))
        seen = Planted(seen.felt[::often], seen.rate[::often])
        x = seen.felt @ parts.gain[i].T + rng.normal(size=3) * plan.bias + noise[0] * plan.sigma
        y = seen.rate @ parts.gyro_gain[i].T
        y = y + (rng.normal(size=3) * plan.gyro_bias + noise[1] * plan.sigma_gyro) * DEG
        for quantity, unit, values in (("acceleration", "m/s2", x), ("angular_rate", "rad/s", y)):
            channels[f"{name}/{quantity}"] = Channel(t, values, unit, quantity, name, plan.hz)
    return Made(Recording(channels, "simulated", "simulated", ""), parts.positions, moving)
