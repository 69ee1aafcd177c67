"""What gyros read that is no rate: bias, drift, specific force; and a curved response."""

import numpy as np

from imucalib.core.array_motion import Array, ArrayEffect, ArrayMotion, own_axis, three
from imucalib.core.parameter import Parameter
from imucalib.units import DEG, STANDARD_GRAVITY

_FULL = 2000.0 * DEG


def _bias(motion: ArrayMotion) -> Array:
    return motion.turned(own_axis(np.full((*motion.shape, 3), DEG)))


def _drift(motion: ArrayMotion) -> Array:
    return _bias(motion) * (motion.order - 0.5)[:, None, None, None]


def _by_force(motion: ArrayMotion) -> Array:
    force = motion.seen(motion.force) * DEG / STANDARD_GRAVITY
    out = np.zeros((*motion.shape, 3, 9))
    for i in range(3):
        out[:, :, i, 3 * i : 3 * i + 3] = force
    return motion.turned(out)


def _cubic(motion: ArrayMotion) -> Array:
    return motion.turned(own_axis(DEG * (motion.seen(motion.rate) / _FULL) ** 3))


EFFECTS = (
    ArrayEffect(
        "gyro_bias",
        "gyroscope",
        "Each gyro axis reads another constant in motion than at rest.",
        "y_i = ω_i + b_i",
        "0.1 deg/s after still calibration",
        "Rests right before and after the motion.",
        three("gyro_bias", "deg/s", 0.1, 20.0),
        _bias,
        scan=True,
    ),
    ArrayEffect(
        "gyro_drift",
        "gyroscope",
        "The gyro biases move steadily during the motion.",
        "y_i = ω_i + d_i (order - 1/2), order from 0 to 1",
        "0.1 deg/s while a board warms up",
        "Let the board warm up first.",
        three("gyro_drift", "deg/s", 0.1, 20.0),
        _drift,
    ),
    ArrayEffect(
        "gyro_g_sensitivity",
        "gyroscope",
        "The gyros also read the specific force.",
        "y_i = ω_i + Σ_j G_ij a_j",
        "MPU-6050 data sheet 6.1: 0.1 deg/s/g",
        "Shake while turning, so that force and rate do not go together.",
        tuple(
            Parameter(f"gyro_g_sensitivity_{i}{j}", "deg/s/g", 0.1, 5.0)
            for i in "xyz"
            for j in "xyz"
        ),
        _by_force,
    ),
    ArrayEffect(
        "gyro_cubic",
        "gyroscope",
        "The gyros' response has a cubic term.",
        "y_i = ω_i + k_i (ω_i / 2000 deg/s)³",
        "MPU-6050 data sheet 6.1: non-linearity 0.2 % of full scale",
        "Turn slowly and fast about each axis.",
        three("gyro_cubic", "deg/s", 4.0, 200.0),
        _cubic,
    ),
)
