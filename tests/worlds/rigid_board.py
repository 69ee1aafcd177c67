"""A rigid board that moves, and what its chips read: plain numpy, no physics of the program.

Force of a chip at r: s + ω × (ω × r) + dω/dt × r. Everything that a chip does to it is written out.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.triads import Triad
from imucalib.recording.recording import Channel, Recording

DEG = np.pi / 180.0
G = 9.80665


@dataclass(frozen=True)
class Board:
    """places : (K, 3) m in the drawing's frame; turns : (K, 3, 3) package axes to board axes
    gains, gyro_gains : (K, 3, 3) and biases (K, 3), of readings turned into board axes
    sigma, gyro_sigma : (K,) m/s² and rad/s; ranges : m/s² and rad/s
    element : (3, 3) m, where the axes x, y, z of every package sense, in package axes
    late : s of all gyros; by_force : (K, 3, 3) rad/s per m/s², in package axes
    """

    places: Array
    turns: Array
    gains: Array
    gyro_gains: Array
    biases: Array
    gyro_biases: Array
    sigma: Array
    gyro_sigma: Array
    ranges: tuple[float, float] = (1e9, 1e9)
    element: Array = field(default_factory=lambda: np.zeros((3, 3)))
    late: float = 0.0
    by_force: Array | None = None

    @property
    def names(self) -> list[str]:
        return [f"imu{k}" for k in range(len(self.places))]


def board(rng: np.random.Generator, chips: int = 8, **more: object) -> Board:
    """Chips on a box of 20 x 20 x 2 mm, each turned anyhow, calibrated only by its file."""
    corners = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], dtype=float)
    places = (
        corners[np.arange(chips) % 8] * [0.01, 0.01, 0.001] + rng.normal(size=(chips, 3)) * 1e-4
    )
    turns = np.linalg.qr(rng.normal(size=(chips, 3, 3)))[0]
    turns[np.linalg.det(turns) < 0] *= -1.0
    small = np.eye(3) + 0.01 * rng.normal(size=(2, chips, 3, 3))
    given: dict[str, object] = {
        "places": places,
        "turns": turns,
        "gains": small[0],
        "gyro_gains": small[1],
        "biases": 0.2 * rng.normal(size=(chips, 3)),
        "gyro_biases": 1.0 * DEG * rng.normal(size=(chips, 3)),
        "sigma": np.full(chips, 0.04),
        "gyro_sigma": np.full(chips, 0.2 * DEG),
    }
    return Board(**{**given, **more})  # type: ignore[arg-type]


@dataclass(frozen=True)
class Moves:
    """t : (T,) s; force, rate, spin, late_rate : (T, 3), the last one `late` seconds before"""

    t: Array
    force: Array
    rate: Array
    spin: Array
    late_rate: Array


def moves(
    rng: np.random.Generator, *, still: float, moving: float, hz: float, twist: float,
    late: float = 0.0, fastest: float = 4.0,
) -> Moves:  # fmt: skip
    """Still in four attitudes, then tones in all axes, slowly begun; twist : deg/s rms an axis."""
    t = np.arange(round((still + moving) * hz)) / hz
    size = rng.normal(size=(8, 3))
    size *= twist * DEG * np.sqrt(2.0) / np.linalg.norm(size, axis=0)
    tone = 2.0 * np.pi * rng.uniform(0.3, fastest, size=(8, 3))
    phase = rng.uniform(0.0, 2.0 * np.pi, size=(8, 3))

    def tones(at: Array) -> tuple[Array, Array, Array]:
        window = np.clip((at - still) / 2.0, 0.0, 1.0)[:, None]
        slope = ((at > still) & (at < still + 2.0))[:, None] / 2.0
        angle = tone * at[:, None, None] + phase
        value = (size * np.sin(angle)).sum(axis=1)
        change = (size * tone * np.cos(angle)).sum(axis=1)
        return window * value, window * change + slope * value, window

    rate, spin, window = tones(t)
    way = np.linalg.qr(rng.normal(size=(4, 3, 3)))[0][:, 0]
    rest = G * way[np.minimum((4 * t / max(still, 1e-9)).astype(int), 3)]
    pull = np.stack([8.0 * np.sin(3.0 * t + k) + 3.0 * np.cos(11.0 * t + k) for k in range(3)], 1)
    return Moves(t, rest * (1 - window) + pull * window, rate, spin, tones(t - late)[0])


def readings(made: Board, motion: Moves, rng: np.random.Generator) -> tuple[Array, Array]:
    """(T, K, 3) acceleration and rate in the sensors' own axes."""
    w, a = motion.rate[:, None], motion.spin[:, None]
    shape = (len(motion.t), len(made.places), 3)
    acceleration, rate = np.empty(shape), np.empty(shape)
    for k in range(shape[1]):
        turn = made.turns[k]
        force = np.empty((shape[0], 3))
        for axis in range(3):  # each axis senses where its element is
            r = (made.places[k] + turn @ made.element[axis])[None, None]
            felt = motion.force[:, None] + np.cross(w, np.cross(w, r)) + np.cross(a, r)
            force[:, axis] = (felt[:, 0] @ turn)[:, axis]
        acceleration[:, k] = force @ turn.T @ made.gains[k].T + made.biases[k]
        turned = motion.late_rate @ made.gyro_gains[k].T + made.gyro_biases[k]
        if made.by_force is not None:
            turned = turned + force @ made.by_force[k].T @ turn.T @ made.gyro_gains[k].T
        rate[:, k] = turned
        acceleration[:, k] = acceleration[:, k] @ turn
        rate[:, k] = rate[:, k] @ turn
    acceleration += rng.normal(size=shape) * made.sigma[:, None]
    rate += rng.normal(size=shape) * made.gyro_sigma[:, None]
    most, fastest = made.ranges
    return np.clip(acceleration, -most, most), np.clip(rate, -fastest, fastest)


def recording(made: Board, t: Array, acceleration: Array, rate: Array) -> Recording:
    channels, hz = {}, 1.0 / float(np.median(np.diff(t)))
    for k, name in enumerate(made.names):
        for what, unit, values in (
            ("acceleration", "m/s2", acceleration[:, k]),
            ("angular_rate", "rad/s", rate[:, k]),
        ):
            there = np.isfinite(values).all(axis=1)
            channels[f"{name}/{what}"] = Channel(t[there], values[there], unit, what, name, hz)
    return Recording(channels, "made", "made", "")


def calibration(made: Board) -> Calibration:
    """The truth as an array's calibration file states it."""
    first = made.places[0]
    effects: list[dict[str, object]] = []
    if made.late:
        effects.append({"effect": "gyro_delay", "parameters": [{"value": 1e3 * made.late}]})
    if made.element.any():
        values = 1e3 * made.element.ravel()
        effects.append({"effect": "sensing_elements", "parameters": [{"value": v} for v in values]})
    if made.by_force is not None:
        values = made.by_force.ravel() * G / DEG
        effects.append(
            {"effect": "gyro_g_sensitivity", "parameters": [{"value": v} for v in values]}
        )
    return Calibration(
        calibrator="array",
        parameters=(),
        covariance=np.zeros((0, 0)),
        raw_unit="m/s2",
        raw_to_si=1.0,
        gravity=G,
        status="ok",
        facts={
            "positions_mm": [
                {"imu": name, "mean": (1e3 * (made.places[k] - first)).tolist()}
                for k, name in enumerate(made.names)
            ],
            "reference_mm": (1e3 * first).tolist(),
            "ranges": {
                "accelerometer_g": made.ranges[0] / G, "gyroscope_deg_per_s": made.ranges[1] / DEG,
            },
            "effects": effects,
        },
        triads=tuple(
            Triad(
                name=name,
                rotation=made.turns[k],
                gain=made.gains[k],
                bias=made.biases[k],
                gyro_gain=made.gyro_gains[k],
                gyro_bias=made.gyro_biases[k],
                covariance=np.zeros((12, 12)),
                noise=float(made.sigma[k]),
                gyro_noise=float(made.gyro_sigma[k]),
            )
            for k, name in enumerate(made.names)
        ),
    )  # fmt: skip


def turned_by(turn: Array, vectors: Array) -> Array:
    """Vectors (..., 3), or a matrix's rows, turned by small angles (3,) rad about the axes."""
    return np.asarray(vectors + np.cross(turn, vectors))
