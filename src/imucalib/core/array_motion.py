"""An effect of an array: what an undeclared error of its sensors adds to their readings.

The shared `Effect` acts on the specific force of a triad. In an array an error may act on the
gyros, or depend on how the board turns, so an array effect is given the whole fitted motion. It is
linear in its parameters: reading = truth + Σ basis(motion)·θ, and every basis comes from the
fitted motion, never from differences of noisy readings.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from imucalib.core.parameter import Parameter

Array = NDArray[np.float64]
Sensor = Literal["accelerometer", "gyroscope"]


@dataclass(frozen=True)
class ArrayMotion:
    """The fitted motion at T instants, board axes, as K triads see it.

    t : (T,) s; order : (T,) 0..1 over the recording's motion
    rate, spin : (T, 3) ω and dω/dt; force, jerk : (T, K, 3) specific force and its derivative
    rotations : (K, 3, 3), package axes to board axes
    age : (T, K) sawtooth of unit span, the beat of each gyro's clock, or None
    """

    imus: tuple[str, ...]
    t: Array
    order: Array
    rate: Array
    spin: Array
    force: Array
    jerk: Array
    rotations: Array
    age: Array | None = None

    @property
    def shape(self) -> tuple[int, int]:
        return len(self.t), len(self.imus)

    def seen(self, vector: Array) -> Array:
        """(T, K, 3) in package axes, of a vector (T, 3) or (T, K, 3) in board axes."""
        whole = np.broadcast_to(vector[:, None] if vector.ndim == 2 else vector, (*self.shape, 3))
        return np.asarray(np.matmul(whole[:, :, None], self.rotations)[:, :, 0])

    def turned(self, basis: Array) -> Array:
        """(T, K, 3, m) in board axes, of a basis in package axes."""
        return np.asarray(np.matmul(self.rotations, basis))


@dataclass(frozen=True)
class ArrayEffect:
    """One named error of an array.

    each : its parameters, of one IMU, or of the whole board when `shared`
    basis : motion -> (T, K, 3, m) in board axes, m/s² or rad/s per unit of each parameter
    scan : whether it is also tried on one IMU at a time
    needs_age : whether it can be tested only where beats were seen
    """

    name: str
    sensor: Sensor
    sentence: str
    equation: str
    source: str
    identify: str
    each: tuple[Parameter, ...]
    basis: Callable[[ArrayMotion], Array]
    shared: bool = False
    scan: bool = False
    needs_age: bool = False

    def missing(self, motion: ArrayMotion) -> str:
        """Why this motion cannot carry the effect; empty when it can."""
        return "no gyro shows a beat line" if self.needs_age and motion.age is None else ""

    def parameters(self, imus: Sequence[str]) -> tuple[Parameter, ...]:
        """In the order of its columns: all of the first IMU, then of the next."""
        if self.shared:
            return self.each
        return tuple(
            Parameter(f"{imu}.{p.name}", p.unit, p.typical, p.plausible)
            for imu in imus
            for p in self.each
        )


def own_axis(values: Array) -> Array:
    """(T, K, 3, 3): each axis adds its own value times its own parameter."""
    return np.asarray(values[..., None] * np.eye(3))


def three(name: str, unit: str, typical: float, plausible: float) -> tuple[Parameter, ...]:
    """One parameter an axis."""
    return tuple(Parameter(f"{name}_{axis}", unit, typical, plausible) for axis in "xyz")
