"""One IMU turned by hand from rest to rest: its own equations, nothing of the code under test.

f, ω in the accelerometer's frame. a = S f + b_a + noise, S lower triangular;
w = M ω + G f + asymmetry |ω| + square ω² + bias + walk + noise, M = K⁻¹.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
G0 = 9.80665
_STEP = 1.0 / 1600.0


@dataclass(frozen=True)
class Chip:
    """S, M : (3, 3); force_bias : (3,) g; rate_bias : (3,) rad/s; by_force : (3, 3) rad/s per g;
    asymmetry : (3,) rad/s per rad/s; square : (3,) per rad/s; noise of a sample at 100 Hz:
    force_noise g, rate_noise rad/s; walk : rad/s per root second; late : s by which the gyroscope
    is late; per_angle : sd, rad a rad turned, by which it is off in each turn anew, as by motion
    between samples"""

    S: Array
    M: Array
    force_bias: Array
    rate_bias: Array
    by_force: Array = field(default_factory=lambda: np.zeros((3, 3)))
    asymmetry: Array = field(default_factory=lambda: np.zeros(3))
    square: Array = field(default_factory=lambda: np.zeros(3))
    force_noise: float = 3e-3
    rate_noise: float = 1e-3
    walk: float = 2e-5
    late: float = 0.0
    per_angle: float = 0.0


def chip(rng: np.random.Generator, **planted: object) -> Chip:
    """An MPU as data sheets describe one: scales to 2 %, cross terms to 1.5 %."""
    S = np.eye(3) + np.tril(rng.normal(0.0, 0.01, (3, 3)))
    M = np.eye(3) + rng.normal(0.0, 0.012, (3, 3))
    return Chip(S, M, rng.normal(0.0, 0.02, 3), rng.normal(0.0, 0.02, 3), **planted)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Log:
    """t, force : of the accelerometer, (n,) s and (n, 3) g; t_gyro, rate : of the gyroscope, rad/s
    up : (n, 3) what gravity truly is at t; still : (N, 2) s, begin and end of every rest"""

    t: Array
    force: Array
    t_gyro: Array
    rate: Array
    up: Array
    still: Array = field(default_factory=lambda: np.zeros((0, 2)))

    def write(self, path: Path, *, rate_unit: float = 1.0, header: str = "") -> Path:
        """A table t, ax, ay, az in m/s², gx, gy, gz, of sensors that sample together."""
        names = header or "time (s),ax (m/s2),ay (m/s2),az (m/s2),gx (rad/s),gy (rad/s),gz (rad/s)"
        table = np.column_stack([self.t, G0 * self.force, rate_unit * self.rate])
        np.savetxt(path, table, delimiter=",", header=names, comments="", fmt="%.9g")
        return path


def turned(
    made: Chip,
    rng: np.random.Generator,
    *,
    rests: int = 14,
    rate: float = 100.0,
    gyro_rate: float | None = None,
    seconds: float = 2.0,
    coning: float = 0.3,
    tremor: float = 0.0,
    plan: Array | None = None,
) -> Log:
    """rests : of about `seconds`, with turns of 70 to 160 deg about changing axes between them
    coning : rad/s of a wobble across the turn's axis; tremor : rad/s rms at rest, as of a hand
    plan : (rests - 1, 3) rotation vectors of the turns, or None for random ones"""
    still = rng.uniform(0.8, 1.3, rests) * seconds
    moving = rng.uniform(1.0, 1.8, rests - 1)
    ends = np.cumsum(np.r_[0.0, np.column_stack([still, np.r_[moving, 0.0]]).ravel()[:-1]])
    n = int(ends[-1] / _STEP)
    at = (np.arange(n) + 0.5) * _STEP
    omega, force_more, astray = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    for k in range(rests - 1):
        begin, length = ends[2 * k + 1], moving[k]
        x = (at - begin) / length
        inside = (x > 0.0) & (x < 1.0)
        bump = 30.0 * x**2 * (1.0 - x) ** 2 * inside  # its integral over x is one
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        vector = axis * rng.uniform(1.2, 2.8) if plan is None else plan[k]
        across = np.cross(vector / np.linalg.norm(vector), rng.normal(size=3))
        other = np.cross(vector / np.linalg.norm(vector), across)
        phase = 2.0 * np.pi * rng.uniform(2.0, 4.0) * (at - begin)
        wobble = np.cos(phase)[:, None] * across + np.sin(phase)[:, None] * other
        omega += bump[:, None] * (vector / length + coning * wobble)
        off = made.per_angle * np.linalg.norm(vector) * rng.normal(size=3)
        astray += bump[:, None] * off / length
        shape = 16.0 * bump * (1.0 - 2.0 * x)
        force_more += 0.01 * shape[:, None] * rng.normal(size=3)
    if tremor:
        omega += tremor * _smooth(rng.normal(size=(n, 3)), int(0.15 / _STEP))
    whole = _attitudes(omega)
    # At the middle of every step, where the rate is told.
    up = whole.inv().apply(_unit(rng.normal(size=3)))
    up = up[1:] + up[:-1]
    up /= np.linalg.norm(up, axis=1)[:, None]
    late = round(made.late / _STEP)
    walk = made.walk * np.sqrt(_STEP) * np.cumsum(rng.normal(size=(n, 3)), axis=0)
    true = up + whole[1:].inv().apply(force_more)
    own = omega @ made.M.T
    read = own + true @ made.by_force.T + made.rate_bias + walk + astray
    read += np.abs(own) * made.asymmetry + own**2 * made.square
    every, of_gyro = (_sampled(n, r) for r in (rate, gyro_rate or rate))
    force = true @ made.S.T + made.force_bias
    root = np.sqrt(rate / 100.0), np.sqrt((gyro_rate or rate) / 100.0)
    return Log(
        t=at[every],
        force=force[every] + made.force_noise * root[0] * rng.normal(size=(len(every), 3)),
        t_gyro=at[of_gyro],
        rate=read[np.maximum(of_gyro - late, 0)]
        + made.rate_noise * root[1] * rng.normal(size=(len(of_gyro), 3)),
        up=up[every],
        still=ends.reshape(-1, 2),
    )


def plan(rests: int) -> Array:
    """135 deg about x, y, z in turn, every second round backwards."""
    return np.array(
        [np.radians(135.0) * np.eye(3)[k % 3] * (-1.0) ** (k // 3) for k in range(rests - 1)]
    )


def _sampled(n: int, rate: float) -> NDArray[np.intp]:
    return np.arange(0, n, 1.0 / (rate * _STEP)).astype(np.intp)


def _smooth(values: Array, width: int) -> Array:
    kernel = np.hanning(width + 2)[1:-1]
    out = np.stack([np.convolve(v, kernel, mode="same") for v in values.T], axis=1)
    return np.asarray(out / out.std())


def _unit(v: Array) -> Array:
    return np.asarray(v / np.linalg.norm(v))


def _attitudes(omega: Array) -> Rotation:
    """(n + 1,) from the body to the start at every step's ends, of steps of a constant rate."""
    each = np.vstack([np.zeros(3), omega * _STEP])
    whole, apart = Rotation.from_rotvec(each), 1
    while apart < len(each):
        more = (whole[:-apart] * whole[apart:]).as_quat()
        whole = Rotation.from_quat(np.concatenate([whole[:apart].as_quat(), more]))
        apart *= 2
    return whole
