"""Gyros that follow the temperature."""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Response, Truth, own_axis, three
from imucalib.units import DEG

_REFERENCE = 25.0  # °C


def _bias(truth: Truth, context: Context) -> Array:
    warmer = (context["temperature"] - _REFERENCE)[:, None, None, None]
    return own_axis(np.full(truth.shape, DEG)) * warmer


def _scale(truth: Truth, context: Context) -> Array:
    warmer = (context["temperature"] - _REFERENCE)[:, None, None, None]
    return 0.01 * own_axis(truth.turning.rate) * warmer


EFFECTS = (
    Response(
        "gyro_temperature_bias",
        "The gyros' biases follow the temperature.",
        "y_i = ω_i + c_i (T - 25 °C)",
        "MPU-6050 data sheet 6.1: 20 deg/s from -40 to 85 °C",
        "Rest at two temperatures or more, with the temperature recorded.",
        ("rate", "temperature"),
        three("gyro_temperature_bias", "deg/s/degC", 0.03, 1.0),
        _bias,
        channel="angular_rate",
    ),
    Response(
        "gyro_temperature_scale",
        "The gyros' scale factors follow the temperature.",
        "y_i = (1 + c_i (T - 25 °C)) ω_i",
        "MPU-6050 data sheet 6.1: 2 % from -40 to 85 °C",
        "Turn by hand at two temperatures or more, with the temperature recorded.",
        ("rate", "temperature"),
        three("gyro_temperature_scale", "%/degC", 0.02, 0.5),
        _scale,
        channel="angular_rate",
    ),
)
