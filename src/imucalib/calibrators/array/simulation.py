"""Whole bench logs of arrays with a known geometry."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.board.board import Board
from imucalib.errors import UsageError
from imucalib.recording.recording import Channel, Recording
from imucalib.units import DEG, STANDARD_GRAVITY


def lever_arm(w: Array, spin: Array, r: Array) -> Array:
    """(T, A, 3) m/s²: Ω(ω)² r + Ω(ω̇) r of positions r (A, 3) m."""
    inner = w @ r.T
    turned = w[:, None] * inner[..., None] - np.sum(w * w, axis=1)[:, None, None] * r
    return np.asarray(turned + np.cross(spin[:, None], r[None]))


@dataclass(frozen=True)
class LogPlan:
    """A bench log: rests in random attitudes, then twisting by hand.

    poses, pose_seconds, seconds : how many rests, of what length, and the length of the motion
    rate : Hz; twist : deg/s, sd of each axis of ω in the motion; force : m/s², sd of s
    scatter : m, sd of the true positions about the drawing
    gain, bias, gyro_gain, gyro_bias : sd of the triads' first-order errors (1, m/s², 1, deg/s)
    planted : undeclared errors by name: gyro_scale (1), gyro_delay (s), quadratic (1 per m/s²)
    """

    poses: int = 20
    pose_seconds: float = 5.0
    seconds: float = 60.0
    rate: float = 100.0
    twist: float = 700.0
    force: float = 10.0
    sigma: float = 0.04
    sigma_gyro: float = 0.2
    scatter: float = 2e-4
    gain: float = 0.01
    bias: float = 0.3
    gyro_gain: float = 0.01
    gyro_bias: float = 2.0
    planted: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class SimulatedLog:
    """recording, and the true positions (K, 3) m relative to the first IMU."""

    recording: Recording
    positions: Array


def simulate_log(board: Board, plan: LogPlan, rng: np.random.Generator) -> SimulatedLog:
    """A whole bench log of a board. Raises UsageError for an unknown planted error."""
    unknown = set(plan.planted) - {"gyro_scale", "gyro_delay", "quadratic"}
    if unknown:
        raise UsageError(f"cannot plant {', '.join(sorted(unknown))}")
    true = board.positions + rng.normal(size=(board.count, 3)) * plan.scatter
    true -= true[0]
    t, w, delayed, force = simulate_motion(plan, rng)
    spin = np.gradient(w, t, axis=0)
    felt = lever_arm(w, spin, true) + force[:, None]
    channels = {}
    for k, name in enumerate(board.imus):
        turn = board.rotations[k].T
        m = np.eye(3) + rng.normal(size=(3, 3)) * plan.gain
        x = felt[:, k] @ (m @ turn).T
        x = x + plan.planted.get("quadratic", 0.0) * x * x + rng.normal(size=3) * plan.bias
        g = np.eye(3) + rng.normal(size=(3, 3)) * plan.gyro_gain
        g *= 1.0 + plan.planted.get("gyro_scale", 0.0)
        y = delayed @ (g @ turn).T + rng.normal(size=3) * plan.gyro_bias * DEG
        x += rng.normal(size=x.shape) * plan.sigma
        y += rng.normal(size=y.shape) * plan.sigma_gyro * DEG
        x = np.clip(x, -board.accelerometer_range, board.accelerometer_range)
        y = np.clip(y, -board.gyroscope_range, board.gyroscope_range)
        for quantity, unit, values in (("acceleration", "m/s2", x), ("angular_rate", "rad/s", y)):
            channels[f"{name}/{quantity}"] = Channel(t, values, unit, quantity, name, plan.rate)
    return SimulatedLog(Recording(channels, "simulated", "simulated", ""), true)


def simulate_motion(plan: LogPlan, rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """Times, ω (rad/s), ω as late gyros see it, and the specific force of the origin (m/s²)."""
    still = plan.poses * plan.pose_seconds
    t = np.arange(round((still + plan.seconds) * plan.rate)) / plan.rate
    moving = np.clip((t - still) / 0.5, 0.0, 1.0) * np.clip((t[-1] - t) / 0.5, 0.0, 1.0)
    late = t - plan.planted.get("gyro_delay", 0.0)
    tones = rng.uniform(0.3, 4.0, size=(12, 3)), rng.uniform(0.0, 2.0 * np.pi, size=(12, 3))
    size = rng.normal(size=(12, 3))
    size *= plan.twist * DEG * np.sqrt(2.0) / np.linalg.norm(size, axis=0)
    direction = rng.normal(size=(plan.poses, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    pose = np.minimum((t / plan.pose_seconds).astype(int), plan.poses - 1)
    rest = STANDARD_GRAVITY * direction[pose]
    shake = rng.uniform(0.3, 4.0, size=(6, 3)), rng.uniform(0.0, 2.0 * np.pi, size=(6, 3))
    pull = np.full((6, 3), plan.force * np.sqrt(2.0 / 6.0))
    force = rest * (1.0 - moving)[:, None] + _tones(t, shake, pull) * moving[:, None]
    window = moving[:, None]
    return t, _tones(t, tones, size) * window, _tones(late, tones, size) * window, force


def _tones(t: Array, tones: tuple[Array, Array], size: Array) -> Array:
    frequency, phase = tones
    angle = 2.0 * np.pi * frequency * t[:, None, None] + phase
    return np.asarray(np.sum(size * np.sin(angle), axis=1))
