"""When the sensors sample: delays of gyros and accelerometers, and clocks of their own."""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.course import delayed
from imucalib.core.effect import Context, Parameter, Response, Truth

_MS = 1e-3


def by_spin(truth: Truth, context: Context) -> Array:
    """(n, K, 3, 1) rad/s that gyros which lag by 1 ms read less, to the first order."""
    return -_MS * truth.turning.spin[..., None]


def by_jerk(truth: Truth, context: Context) -> Array:
    """(n, K, 3, 1) m/s² that accelerometers which lag by 1 ms read less, to the first order."""
    return -_MS * truth.turning.jerk[..., None]


def _age(truth: Truth, context: Context) -> Array:
    return np.asarray(by_spin(truth, context) * context["sample_age"][:, :, None, None])


def _one(name: str, typical: float) -> tuple[Parameter, ...]:
    return (Parameter(name, "ms", typical, 20.0),)


class _Aged(Response):
    def missing(self, context: Context) -> str:
        return "no gyro shows a beat line" if super().missing(context) else ""


EFFECTS = (
    Response(
        "gyro_delay",
        "All gyros are late against the accelerometers by one delay.",
        "y(t) = ω(t - τ)",
        "filter group delays: 1 ms in MPU firmware comments",
        "Turn fast, with strong angular acceleration.",
        ("spin",),
        _one("gyro_delay", 1.0),
        by_spin,
        channel="angular_rate",
        shared=True,
        lagged=delayed,
    ),
    Response(
        "gyro_delay_each",
        "Each gyro has its own delay.",
        "y_k(t) = ω(t - τ_k)",
        "sequential read-out, 0.1-1 ms",
        "Turn fast, with strong angular acceleration.",
        ("spin",),
        _one("gyro_own_delay", 0.3),
        by_spin,
        channel="angular_rate",
        lagged=delayed,
        remedy="its gyro is read late: check its bus and its filter",
    ),
    Response(
        "accelerometer_delay",
        "Each accelerometer has its own delay.",
        "y_k(t) = a_k(t - τ_k)",
        "sequential read-out, 0.1-1 ms",
        "Shake fast; a higher sample rate tells a delay from a low-pass.",
        ("jerk",),
        _one("accelerometer_delay", 0.3),
        by_jerk,
        lagged=delayed,
        remedy="it is read late: check its bus and its filter",
    ),
    _Aged(
        "gyro_sample_age",
        "Gyros that sample on their own clocks: the age of a reading is a sawtooth of one span.",
        "y_k(t) = ω(t - T (φ_k(t) mod 1 - 1/2)), φ_k by the beat line of gyro k",
        "chips that refresh at 1 kHz and are read at another rate",
        "Half a minute of motion with strong angular acceleration shows the beats.",
        ("spin", "sample_age"),
        _one("sample_age_span", 1.0),
        _age,
        channel="angular_rate",
        shared=True,
        lagged=delayed,
    ),
)
