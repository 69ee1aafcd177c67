"""Smooth curves without a name, as effects: what an array's errors could follow.

Each is Σ_k c_k √2 cos(π k u) / k of a driver scaled to u = 0..1 over what the motion showed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from imucalib.core.array_motion import ArrayEffect, ArrayMotion, Sensor
from imucalib.core.parameter import Parameter
from imucalib.estimators.array.samples import turning
from imucalib.units import DEG

Array = NDArray[np.float64]
Driver = Callable[[ArrayMotion], Array]
#: Typical size of an unknown curve (m/s² and deg/s), and how many terms it has.
_SIZE, _TERMS = {"accelerometer": 0.1, "gyroscope": 0.3}, 4
#: The same of an IMU that moves on the board (mm) or whose clock does (ms).
_MOVE, _LATE, _SLOW = 0.05, 0.05, 2


def array_curves(motion: ArrayMotion) -> Iterator[tuple[str, ArrayEffect]]:
    """Driver and curve: each axis' error, alike in all packages, against the size of rate and
    force and against what the axis itself reads; of each IMU by itself against time. Without a
    driver: of one IMU at a time, which stands for "{imu}" in the name."""
    sensors: tuple[Sensor, ...] = ("accelerometer", "gyroscope")
    for sensor in sensors:
        own = ("its own a", "a", _force) if sensor == "accelerometer" else ("its own ω", "ω", _rate)
        for words, driver, of, shared in (
            ("|ω|", "|ω|", _speed, True),
            ("|a|", "|a|", _strength, True),
            ("time", "time", _time, False),
            (*own, True),
        ):
            name = f"{sensor} error against {words}"
            yield driver, _curve(name, sensor, words, of, motion, shared)
    for words, wander in (("position", _moves), ("gyro delay", _drifts)):
        yield "", wander(f"{words} of {{imu}} against time")


def _curve(
    name: str, sensor: Sensor, words: str, of: Driver, motion: ArrayMotion, shared: bool
) -> ArrayEffect:
    values = of(motion)
    low, high = float(values.min()), float(values.max())
    unit, scale = ("m/s2", 1.0) if sensor == "accelerometer" else ("deg/s", DEG)

    def basis(now: ArrayMotion) -> Array:
        curves = scale * _cosines(of(now), low, high, _TERMS)
        if curves.ndim == 3:
            whole = np.einsum("tkc,ij->tkijc", curves, np.eye(3))
        else:  # a driver of each axis
            whole = np.einsum("tkic,ij->tkijc", curves, np.eye(3))
        return now.turned(whole.reshape(*now.shape, 3, -1))

    each = tuple(
        Parameter(f"{axis}_{k}", unit, _SIZE[sensor], np.inf)
        for axis in "xyz"
        for k in range(1, _TERMS + 1)
    )
    equation = (
        f"error_i = Σ_k c_ik √2 cos(π k u) / k, u = (v - {low:.6g}) / {high - low:.6g} in 0..1, "
        f"v = {words} (SI)"
    )
    return ArrayEffect(name, sensor, "A curve without a name.", equation, "the residual", "",
                       each, basis, shared)  # fmt: skip


def _moves(name: str) -> ArrayEffect:
    def basis(motion: ArrayMotion) -> Array:
        turn = 1e-3 * turning(motion.rate, motion.spin)
        whole = np.einsum("tij,tc->tijc", turn, _cosines(motion.order, 0.0, 1.0, _SLOW))
        flat = whole.reshape(len(motion.t), 1, 3, -1)
        return np.broadcast_to(flat, (*motion.shape, 3, flat.shape[3]))

    each = tuple(
        Parameter(f"{axis}_{k}", "mm", _MOVE, np.inf) for axis in "xyz" for k in range(1, _SLOW + 1)
    )
    equation = "r = r_k + Σ_k c_k √2 cos(π k order) / k, order from 0 to 1"
    return ArrayEffect(name, "accelerometer", "An IMU that moves on the board.", equation,
                       "the residual", "", each, basis)  # fmt: skip


def _drifts(name: str) -> ArrayEffect:
    def basis(motion: ArrayMotion) -> Array:
        curves = -1e-3 * _cosines(motion.order, 0.0, 1.0, _SLOW)
        flat = np.einsum("ti,tc->tic", motion.spin, curves)[:, None]
        return np.broadcast_to(flat, (*motion.shape, 3, _SLOW))

    each = tuple(Parameter(f"delay_{k}", "ms", _LATE, np.inf) for k in range(1, _SLOW + 1))
    equation = "y(t) = ω(t - τ), τ = Σ_k c_k √2 cos(π k order) / k, order from 0 to 1"
    return ArrayEffect(name, "gyroscope", "A gyro whose clock wanders.", equation,
                       "the residual", "", each, basis)  # fmt: skip


def _speed(motion: ArrayMotion) -> Array:
    return np.broadcast_to(np.linalg.norm(motion.rate, axis=1)[:, None], motion.shape)


def _strength(motion: ArrayMotion) -> Array:
    return np.asarray(np.linalg.norm(motion.force, axis=2))


def _time(motion: ArrayMotion) -> Array:
    return np.broadcast_to(motion.order[:, None], motion.shape)


def _force(motion: ArrayMotion) -> Array:
    return motion.seen(motion.force)


def _rate(motion: ArrayMotion) -> Array:
    return motion.seen(motion.rate)


def _cosines(values: Array, low: float, high: float, terms: int) -> Array:
    unit = np.clip((values - low) / max(high - low, 1e-300), 0.0, 1.0)
    k = np.arange(1, terms + 1)
    return np.asarray(np.sqrt(2.0) * np.cos(np.pi * k * unit[..., None]) / k)
