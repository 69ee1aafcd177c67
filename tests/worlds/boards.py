"""Whole bench logs of arrays by numpy alone: rests, turns between them that gyros can follow, and
twisting; written from the equations of rigid motion, apart from the program's own simulation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.recording.recording import Channel, Recording

DEG = np.pi / 180.0


@dataclass(frozen=True)
class BoardPlan:
    """rests, rest_s, turn_s, twist_s : how many rests, and how long each rest, each turn between
    them and the twisting last; hz; rate : deg/s, sd of each axis of ω in the twisting; force : m/s²
    places : m, sd of the true positions about the drawing; gain, bias, gyro_gain, gyro_bias : sd of
    each triad's errors (1, m/s², 1, deg/s); mounting : deg, sd of a package's turn about each axis
    sigma, sigma_gyro : m/s² and deg/s of one axis; tails : degrees of freedom of their Student t,
    in the twisting, shared by a triad's axes; gyro_scale : common to all gyros
    about : unit vectors that the board is twisted about, three where all axes are"""

    rests: int = 14
    rest_s: float = 2.0
    turn_s: float = 1.0
    twist_s: float = 20.0
    hz: float = 100.0
    rate: float = 700.0
    force: float = 10.0
    places: float = 2e-4
    gain: float = 0.005
    bias: float = 0.3
    gyro_gain: float = 0.0
    gyro_bias: float = 2.0
    mounting: float = 0.0
    sigma: float = 0.04
    sigma_gyro: float = 0.2
    tails: float = np.inf
    gyro_scale: float = 0.0
    gravity: float = 9.80665
    about: tuple[tuple[float, float, float], ...] = (
        (1.0, 0.0, 0.0),
        (0.0, 1.0, 0.0),
        (0.0, 0.0, 1.0),
    )


@dataclass(frozen=True)
class Made:
    """recording; positions : (K, 3) m relative to the first IMU, in the board's axes; motion :
    (N,) samples that twist"""

    recording: Recording
    positions: Array
    motion: NDArray[np.bool_]


def turned(axis: Array, angle: Array) -> Array:
    """(n, 3, 3) rotations about a unit axis by angles (n,): Rodrigues' formula."""
    k = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.asarray(
        np.eye(3)
        + np.sin(angle)[:, None, None] * k
        + (1.0 - np.cos(angle))[:, None, None] * (k @ k)
    )


def handled(plan: BoardPlan, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """ω, dω/dt (rad/s, rad/s²) and the specific force of the origin (m/s²), all (n, 3) in board
    axes, of rests and the turns between them."""
    still, turning = round(plan.rest_s * plan.hz), round(plan.turn_s * plan.hz)
    attitude = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    attitude = attitude * np.sign(np.linalg.det(attitude))
    up = plan.gravity * np.array([0.0, 0.0, 1.0])
    w, spin, force = [], [], []
    # A smooth step 10 u³ - 15 u⁴ + 6 u⁵ of the angle: at rest, and without a kick, at both ends.
    u = np.arange(turning) / turning
    step = 10 * u**3 - 15 * u**4 + 6 * u**5
    first = (30 * u**2 - 60 * u**3 + 30 * u**4) / plan.turn_s
    second = (60 * u - 180 * u**2 + 120 * u**3) / plan.turn_s**2
    for k in range(plan.rests):
        w.append(np.zeros((still, 3)))
        spin.append(np.zeros((still, 3)))
        force.append(np.tile(attitude.T @ up, (still, 1)))
        if k + 1 < plan.rests:
            axis = rng.normal(size=3)
            axis /= np.linalg.norm(axis)
            angle = rng.uniform(60.0, 150.0) * DEG
            path = attitude @ turned(axis, angle * step)
            w.append(angle * first[:, None] * axis)
            spin.append(angle * second[:, None] * axis)
            force.append(np.einsum("nji,j->ni", path, up))
            attitude = attitude @ turned(axis, np.array([angle]))[0]
    return np.concatenate(w), np.concatenate(spin), np.concatenate(force)


def twisted(plan: BoardPlan, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """The same of the twisting: twelve tones an axis, within a window."""
    n = round(plan.twist_s * plan.hz)
    t = np.arange(n)[:, None, None] / plan.hz
    f, phase = 2.0 * np.pi * rng.uniform(0.3, 4.0, (12, 3)), rng.uniform(0.0, 2.0 * np.pi, (12, 3))
    size = rng.normal(size=(12, 3))
    size *= plan.rate * DEG * np.sqrt(2.0) / np.linalg.norm(size, axis=0)
    w = np.sum(size * np.sin(f * t + phase), axis=1)
    spin = np.sum(size * f * np.cos(f * t + phase), axis=1)
    edge = 0.5
    x = np.clip(np.minimum(t[:, 0, 0], plan.twist_s - t[:, 0, 0]) / edge, 0.0, 1.0)
    sign = np.where(t[:, 0, 0] < 0.5 * plan.twist_s, 1.0, -1.0)
    window = (3 * x**2 - 2 * x**3)[:, None]
    slope = (sign * (6 * x - 6 * x**2) / edge)[:, None]
    spin = spin * window + w * slope
    w, spin = (v[:, : len(plan.about)] @ np.array(plan.about) for v in (w, spin))
    pull = rng.uniform(0.3, 4.0, (6, 3)) * 2.0 * np.pi, rng.uniform(0.0, 2.0 * np.pi, (6, 3))
    force = plan.force * np.sqrt(1.0 / 3.0) * np.sum(np.sin(pull[0] * t + pull[1]), axis=1)
    return w * window, spin, force * window + plan.gravity * np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Parts:
    """One board as it was made: names; positions : (K, 3) m relative to the first IMU; gain,
    gyro_gain : (K, 3, 3) of reading = gain · truth in board axes"""

    names: tuple[str, ...]
    positions: Array
    gain: Array
    gyro_gain: Array


def made_board(
    drawn: Array, rotations: Array, names: tuple[str, ...], plan: BoardPlan,
    rng: np.random.Generator,
) -> Parts:  # fmt: skip
    """A board about its drawing: positions (K, 3) m and rotations (K, 3, 3), package to board."""
    k = len(drawn)
    positions = drawn + rng.normal(size=drawn.shape) * plan.places
    gains = []
    for i in range(k):
        small = rng.normal(size=3) * plan.mounting * DEG
        size = max(float(np.linalg.norm(small)), 1e-12)
        own = rotations[i].T @ turned(small / size, np.array([size]))[0]
        gain = (np.eye(3) + rng.normal(size=(3, 3)) * plan.gain) @ own
        gyro = (np.eye(3) + rng.normal(size=(3, 3)) * plan.gyro_gain) @ own
        gains.append((gain, gyro * (1.0 + plan.gyro_scale)))
    acceleration, rate = (np.array(g) for g in zip(*gains, strict=True))
    return Parts(names, positions - positions[0], acceleration, rate)


@dataclass(frozen=True)
class Moved:
    """The truth: t (n,); rate, spin, force (n, 3) of the origin in board axes"""

    t: Array
    rate: Array
    spin: Array
    force: Array

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


def board_log(
    parts: Parts, plan: BoardPlan, rng: np.random.Generator, plant: Plant = plain, often: int = 1
) -> Made:
    """A log of a board, whose biases are anew like its motion and noise; plant : what its IMUs
    sense; often : steps of the truth from sample to sample, for what has a memory."""
    fine = replace(plan, hz=often * plan.hz)
    rests, twist = handled(fine, rng), twisted(fine, rng)
    w, spin, force = (np.concatenate(pair) for pair in zip(rests, twist, strict=True))
    truth = Moved(np.arange(len(w)) / fine.hz, w, spin, force)
    t, motion = truth.t[::often], (np.arange(len(w)) >= len(rests[0]))[::often]
    n, channels = len(t), {}
    for i, name in enumerate(parts.names):
        seen = plant(truth, parts.positions[i], i)
        noise = rng.normal(size=(2, n, 3))
        if np.isfinite(plan.tails):
            heavy = np.sqrt(plan.tails / rng.chisquare(plan.tails, (2, n, 1)))
            noise *= np.where(motion[:, None], heavy, 1.0)
        x = seen.felt[::often] @ parts.gain[i].T + rng.normal(size=3) * plan.bias
        x = x + noise[0] * plan.sigma
        y = seen.rate[::often] @ parts.gyro_gain[i].T
        y = y + (rng.normal(size=3) * plan.gyro_bias + noise[1] * plan.sigma_gyro) * DEG
        for quantity, unit, values in (("acceleration", "m/s2", x), ("angular_rate", "rad/s", y)):
            channels[f"{name}/{quantity}"] = Channel(t, values, unit, quantity, name, plan.hz)
    return Made(Recording(channels, "simulated", "simulated", ""), parts.positions, motion)
