"""Boards with something that nobody declared, on the logs of `worlds.boards`: by numpy alone.

Each plant changes what one IMU, or a few, read at the true motion.
"""

from __future__ import annotations

import numpy as np

from worlds.boards import DEG, Array, BoardPlan, Moved, Plant, Planted, plain

G = 9.80665
PLAN = BoardPlan(twist_s=25.0, mounting=0.3, gyro_gain=0.005)


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


def leading(m: Moved, r: Array, k: int) -> Planted:
    """imu2's gyro is .2 ms before the others."""
    one = plain(m, r, k)
    if k != 2:
        return one
    early = [np.interp(m.t + 2e-4, m.t, axis) for axis in one.rate.T]
    return Planted(one.felt, np.stack(early, axis=1))


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
