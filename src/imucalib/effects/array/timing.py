"""When the sensors sample: delays of gyros and accelerometers, and clocks of their own."""

import numpy as np

from imucalib.core.array_motion import Array, ArrayEffect, ArrayMotion
from imucalib.core.parameter import Parameter

_MS = 1e-3


def _spin(motion: ArrayMotion) -> Array:
    return np.broadcast_to(-_MS * motion.spin[:, None, :, None], (*motion.shape, 3, 1))


def _jerk(motion: ArrayMotion) -> Array:
    return -_MS * motion.jerk[..., None]


def _age(motion: ArrayMotion) -> Array:
    assert motion.age is not None
    return np.asarray(_spin(motion) * motion.age[:, :, None, None])


def _one(name: str, typical: float) -> tuple[Parameter, ...]:
    return (Parameter(name, "ms", typical, 20.0),)


EFFECTS = (
    ArrayEffect(
        "gyro_delay",
        "gyroscope",
        "All gyros are late against the accelerometers by one delay.",
        "y(t) = ω(t - τ)",
        "filter group delays: 1 ms in MPU firmware comments",
        "Turn fast, with strong angular acceleration.",
        _one("gyro_delay", 1.0),
        _spin,
        shared=True,
    ),
    ArrayEffect(
        "gyro_delay_each",
        "gyroscope",
        "Each gyro has its own delay.",
        "y_k(t) = ω(t - τ_k)",
        "sequential read-out, 0.1-1 ms",
        "Turn fast, with strong angular acceleration.",
        _one("gyro_delay", 0.3),
        _spin,
    ),
    ArrayEffect(
        "accelerometer_delay",
        "accelerometer",
        "Each accelerometer has its own delay.",
        "y_k(t) = a_k(t - τ_k)",
        "sequential read-out, 0.1-1 ms; a low-pass of its own looks alike",
        "Shake fast; a higher sample rate tells a delay from a low-pass.",
        _one("accelerometer_delay", 0.3),
        _jerk,
    ),
    ArrayEffect(
        "gyro_sample_age",
        "gyroscope",
        "Gyros that sample on their own clocks: the age of a reading is a sawtooth of one span.",
        "y_k(t) = ω(t - T (φ_k(t) mod 1 - 1/2)), φ_k by the beat line of gyro k",
        "chips that refresh at 1 kHz and are read at another rate",
        "Half a minute of motion with strong angular acceleration shows the beats.",
        _one("sample_age_span", 1.0),
        _age,
        shared=True,
        needs_age=True,
    ),
)
