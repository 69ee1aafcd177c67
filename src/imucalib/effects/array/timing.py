"""When sensors read: delays, low-passes, and clocks of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.course import Course, calm, delay
from imucalib.core.effect import Context, Parameter, Response
from imucalib.effects.array.parts import JERK, SPIN, all_axes, times

_FILTERS = "filters of 5 to 260 Hz in MPU-6050 data sheets: 0.6 to 30 ms"
_WEAKENED = "Shake and turn fast: a delay keeps what is fast, a low-pass weakens it."
_TURN_FAST = "Turn fast, with strong angular acceleration."
#: What sensors that lag by 1 ms read less, to the first order: rad/s and m/s².
_LATE_GYROS, _LATE_FORCES = all_axes(SPIN, -1e-3), all_axes(JERK, -1e-3)


class _Aged(Response):
    def missing(self, context: Context) -> str:
        return "no gyro shows a beat line" if super().missing(context) else ""


def slow(course: Course, lag: Array) -> Course:
    """Behind low-passes of time constants `lag` (n, K, 1) s, of which the first counts, against a
    course that has passed one itself: a negative lag is that of a quicker sensor.

    No filter has a negative time, so that the course has passed one of c = -min(lag), or of none.
    y = (1 + c d/dt) / (1 + (τ + c) d/dt) x = x - τ z, z what a low-pass of τ + c leaves of dx/dt.
    """
    tau = lag[0, :, 0]
    own = max(0.0, -float(tau.min()))
    value, slope = course.value.copy(), course.slope.copy()
    for k in np.flatnonzero(tau):
        total = tau[k] + own
        if total > 0.0:
            z = _low_passed(course, int(k), float(total))
            changed = (own * course.slope[:, k] + tau[k] * z) / total
        else:
            z, changed = course.slope[:, k], course.slope[:, k] + own * course.plain[:, k]
        value[:, k] -= tau[k] * z
        slope[:, k] = changed
    return replace(course, value=value, slope=slope)


def _low_passed(course: Course, k: int, tau: float) -> Array:
    """(n, 3) z of z + τ dz/dt = dx/dt. Of the fourth order in the interval h: the slopes of z at
    neighbours hold (z'₋ + 4 z' + z'₊) / 6 = (z₊ - z₋) / 2 h (`core/course`). A stretch of samples
    begins where a slow course would be, dx/dt - τ d²x/dt², as far as the noise that this brings
    back allows (`core/course`), else as at its second sample, and ends by the trapezoidal rule."""
    from scipy.linalg import solve_banded

    x, t, (before, after) = course.slope[:, k], course.t, course.beside.T
    inner, last, start = before & after, before & ~after, ~before & after
    step = np.diff(t, prepend=t[0] - 1.0)  # where nothing is before, it is not used
    own = np.where(inner, 4.0, np.where(last, 3.0, 6.0)) / 6.0
    down = np.where(inner, 1.0, np.where(last, 3.0, 0.0)) / 6.0
    up = inner / 6.0
    ahead = tau / np.where(inner, 2.0 * step, np.inf)
    behind = tau / np.where(last, step, np.inf)
    known = own[:, None] * x + down[:, None] * np.roll(x, 1, axis=0)
    known += up[:, None] * np.roll(x, -1, axis=0)
    share = float(calm(tau, course))
    known[start] = share * (x - tau * course.bend[:, k])[start]
    up[start] = share - 1.0
    bands = np.zeros((3, len(t)))  # above, on and below the diagonal, by columns
    bands[0, 1:] = (up + ahead)[:-1]
    bands[1] = own + behind
    bands[2, :-1] = (down - ahead - behind)[1:]
    return np.asarray(solve_banded((1, 1), bands, known))


EFFECTS = (
    Response(
        "gyro_delay",
        "All gyros are late against the accelerometers by one delay.",
        "y(t) = ω(t - τ)",
        "filter group delays: 1 ms in MPU firmware comments",
        _TURN_FAST,
        ("spin",),
        (Parameter("gyro_delay", "ms", 1.0, 20.0),),
        _LATE_GYROS,
        channel="angular_rate",
        shared=True,
        lagged=delay,
    ),
    Response(
        "gyro_delay_each",
        "Each gyro has its own delay.",
        "y_k(t) = ω(t - τ_k)",
        "sequential read-out, 0.1-1 ms",
        _TURN_FAST,
        ("spin",),
        (Parameter("gyro_own_delay", "ms", 0.3, 20.0),),
        _LATE_GYROS,
        channel="angular_rate",
        lagged=delay,
        remedy="its gyro is read late: check its bus and its filter",
    ),
    Response(
        "accelerometer_delay",
        "Each accelerometer has its own delay.",
        "y_k(t) = a_k(t - τ_k)",
        "sequential read-out, 0.1-1 ms",
        "Shake fast; a higher sample rate tells a delay from a low-pass.",
        ("jerk",),
        (Parameter("accelerometer_delay", "ms", 0.3, 20.0),),
        _LATE_FORCES,
        lagged=delay,
        remedy="it is read late: check its bus and its filter",
    ),
    _Aged(
        "gyro_sample_age",
        "Gyros that sample on their own clocks: the age of a reading is a sawtooth of one span.",
        "y_k(t) = ω(t - T (φ_k(t) mod 1 - 1/2)), φ_k by the beat line of gyro k",
        "chips that refresh at 1 kHz and are read at another rate",
        "Half a minute of motion with strong angular acceleration shows the beats.",
        ("spin", "sample_age"),
        (Parameter("sample_age_span", "ms", 1.0, 20.0),),
        times(_LATE_GYROS, lambda truth, context: context["sample_age"]),
        channel="angular_rate",
        shared=True,
        lagged=delay,
    ),
    Response(
        "accelerometer_low_pass",
        "Each accelerometer has its own low-pass of the first order.",
        "y_k + τ_k dy_k/dt = a_k",
        _FILTERS,
        _WEAKENED,
        ("jerk",),
        (Parameter("accelerometer_time_constant", "ms", 0.3, 50.0, least=0.0),),
        _LATE_FORCES,
        lagged=slow,
        twin="accelerometer_delay",
        remedy="its filter is not that of the others: set it as theirs",
    ),
    Response(
        "common_accelerometer_low_pass",
        "All accelerometers have one low-pass of the first order that the gyros lack.",
        "y + τ dy/dt = a, the same for all",
        _FILTERS,
        _WEAKENED,
        ("jerk",),
        (Parameter("common_time_constant", "ms", 1.0, 50.0, least=0.0),),
        _LATE_FORCES,
        shared=True,
        lagged=slow,
        twin="gyro_delay",
    ),
    Response(
        "gyro_low_pass",
        "All gyros have one low-pass of the first order that the accelerometers lack.",
        "y + τ dy/dt = ω, the same for all",
        _FILTERS,
        _WEAKENED,
        ("spin",),
        (Parameter("gyro_time_constant", "ms", 1.0, 50.0, least=0.0),),
        _LATE_GYROS,
        channel="angular_rate",
        shared=True,
        lagged=slow,
        twin="gyro_delay",
    ),
    Response(
        "gyro_low_pass_each",
        "Each gyro has its own low-pass of the first order.",
        "y_k + τ_k dy_k/dt = ω",
        _FILTERS,
        _WEAKENED,
        ("spin",),
        (Parameter("gyro_own_time_constant", "ms", 0.3, 50.0, least=0.0),),
        _LATE_GYROS,
        channel="angular_rate",
        lagged=slow,
        twin="gyro_delay_each",
        remedy="its gyro's filter is not that of the others: set it as theirs",
    ),
)
