"""What gyros read that is no rate: bias, drift, specific force; and a curved response."""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Parameter, Response, Truth, own_axis, three
from imucalib.units import DEG, STANDARD_GRAVITY

_FULL = 2000.0 * DEG


def _bias(truth: Truth, context: Context) -> Array:
    return own_axis(np.full(truth.shape, DEG))


def _drift(truth: Truth, context: Context) -> Array:
    return _bias(truth, context) * (context["order"] - 0.5)[:, None, None, None]


def _by_force(truth: Truth, context: Context) -> Array:
    force = truth.force * DEG / STANDARD_GRAVITY
    out = np.zeros((*truth.shape, 9))
    for i in range(3):
        out[..., i, 3 * i : 3 * i + 3] = force
    return out


def _quadratic(truth: Truth, context: Context) -> Array:
    return own_axis(DEG * (truth.turning.rate / _FULL) ** 2)


def _cubic(truth: Truth, context: Context) -> Array:
    return own_axis(DEG * (truth.turning.rate / _FULL) ** 3)


EFFECTS = (
    Response(
        "gyro_bias",
        "Each gyro axis reads another constant in motion than at rest.",
        "y_i = ω_i + b_i",
        "0.1 deg/s after still calibration",
        "Rests right before and after the motion.",
        ("rate",),
        three("gyro_bias", "deg/s", 0.1, 20.0),
        _bias,
        channel="angular_rate",
        scan=True,
    ),
    Response(
        "gyro_drift",
        "The gyro biases move steadily during the motion.",
        "y_i = ω_i + d_i (order - 1/2), order from 0 to 1",
        "0.1 deg/s while a board warms up",
        "Let the board warm up first.",
        ("rate", "order"),
        three("gyro_drift", "deg/s", 0.1, 20.0),
        _drift,
        channel="angular_rate",
    ),
    Response(
        "gyro_g_sensitivity",
        "The gyros also read the specific force.",
        "y_i = ω_i + Σ_j G_ij a_j",
        "MPU-6050 data sheet 6.1: 0.1 deg/s/g",
        "Shake while turning, so that force and rate do not go together.",
        ("rate",),
        tuple(
            Parameter(f"gyro_g_sensitivity_{i}{j}", "deg/s/g", 0.1, 5.0)
            for i in "xyz"
            for j in "xyz"
        ),
        _by_force,
        channel="angular_rate",
    ),
    Response(
        "gyro_quadratic",
        "The gyros' response has a quadratic term.",
        "y_i = ω_i + q_i (ω_i / 2000 deg/s)²",
        "MPU-6050 data sheet 6.1: non-linearity 0.2 % of full scale",
        "Turn both ways about each axis, slowly and fast.",
        ("rate",),
        three("gyro_quadratic", "deg/s", 4.0, 200.0),
        _quadratic,
        channel="angular_rate",
        scan=True,
    ),
    Response(
        "gyro_cubic",
        "The gyros' response has a cubic term.",
        "y_i = ω_i + k_i (ω_i / 2000 deg/s)³",
        "MPU-6050 data sheet 6.1: non-linearity 0.2 % of full scale",
        "Turn slowly and fast about each axis.",
        ("rate",),
        three("gyro_cubic", "deg/s", 4.0, 600.0),
        _cubic,
        channel="angular_rate",
    ),
)
