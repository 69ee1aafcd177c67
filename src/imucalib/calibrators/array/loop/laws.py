"""What an array's sensors may follow without a name: unnamed laws, and free functions.

A law is as simple as a name, but of another shape: one number an axis of each IMU, as names of
drifts and of non-linearity have it. What such a law of a driver explains as well has no certain
name. A free function is any smooth course of a driver, alike in all packages.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.loop.motion import BoardMotion
from imucalib.core.context import Context
from imucalib.core.course import delayed
from imucalib.core.effect import Channel, Response, own_axis, three
from imucalib.core.parameter import Parameter
from imucalib.core.truth import Truth
from imucalib.effects.array.sensing_elements import across
from imucalib.units import DEG, MG

#: How the name of a correction without a cause begins.
CURVE = "curve of "

Shape = Callable[[Array], Array]
Driver = Callable[[Truth], Array]


def _power(p: float) -> Shape:
    return lambda x: np.asarray(np.sign(x) * np.abs(x) ** p)


def _even(p: float) -> Shape:
    return lambda x: np.asarray(np.abs(x) ** p)


def _end(at: float) -> Shape:
    return lambda x: np.sign(x) * np.maximum(np.abs(x) - at, 0.0)


def _soft_end(at: float) -> Shape:
    return lambda x: np.asarray(np.sign(x) * np.maximum(np.abs(x) - at, 0.0) ** 2)


def _settling(u: Array) -> Array:
    return np.exp(-8.0 * u)


def _straight(u: Array) -> Array:
    return 2.0 * u - 1.0


def _bent(u: Array) -> Array:
    return 6.0 * u * (u - 1.0) + 1.0


#: Of what a sensor reads over the most in this motion; and of time over the motion, 0..1.
_OF_INPUT = {
    "to the power 1.5": _power(1.5),
    "beyond a half": _end(0.5),
    "softly beyond a half": _soft_end(0.5),
    "cubed, without sign": _even(3.0),
}
_OF_TIME = {"as it settles": _settling, "bent": _bent}
#: The same where even a straight line has no name.
_OF_PLACE = {"straight": _straight, "bent": _bent}
#: Terms of a free function, Σ_k c_k √2 cos(π k u) / k of its driver scaled to u = 0..1.
_TERMS = 4


def array_laws(motion: BoardMotion) -> Iterator[tuple[str, Response]]:
    """Driver and law."""
    gyro: Channel = "angular_rate"
    force: Channel = "acceleration"
    fast = float(np.abs(motion.truth.turning.rate).max())
    strong = float(np.abs(motion.truth.force).max())
    for words, shape in _OF_INPUT.items():
        yield _of("rate", "gyro error", words, "deg/s", 4.0, gyro, _by_rate(shape, fast))
        yield _of("force", "force error", words, "mg", 5.0, force, _by_force(shape, strong, MG))
        yield _of("force", "gyro error", words, "deg/s", 1.0, gyro, _by_force(shape, strong, DEG))
    for words, shape in _OF_TIME.items():
        yield _of("time", "gyro offset", words, "deg/s", 0.1, gyro, _offset(shape, DEG))
        yield _of("time", "gyro scale", words, "%", 0.2, gyro, _scale(shape, "rate"))
        yield _of("time", "offset", words, "mg", 2.0, force, _offset(shape, MG))
        yield _of("time", "scale", words, "%", 0.1, force, _scale(shape, "force"))
    for words, shape in _OF_PLACE.items():
        yield _of("time", "position", words, "mm", 0.05, force, _place(shape))
        yield _of("time", "gyro delay", words, "ms", 0.05, gyro, _delay(shape))


def array_functions(motion: BoardMotion) -> Iterator[tuple[str, Response]]:
    """Driver and free function: each axis' error against the size of rate and force. Against what
    all axes themselves read, positions would follow it."""
    sensors: tuple[tuple[Channel, str, str, float], ...] = (
        ("acceleration", "force error", "m/s2", 0.1),
        ("angular_rate", "gyro error", "deg/s", 0.3),
    )
    for channel, error, unit, typical in sensors:
        for driver, of in (("|ω|", _speed), ("|a|", _strength)):
            yield driver, _function(channel, error, unit, typical, driver, of, motion)


def _function(
    channel: Channel, error: str, unit: str, typical: float, driver: str, of: Driver,
    motion: BoardMotion,
) -> Response:  # fmt: skip
    values = of(motion.truth)
    low, high = float(values.min()), float(values.max())
    k, scale = np.arange(1, _TERMS + 1), DEG if channel == "angular_rate" else 1.0

    def basis(truth: Truth, context: Context) -> Array:
        unit = np.clip((of(truth) - low) / max(high - low, 1e-300), 0.0, 1.0)
        curves = scale * np.sqrt(2.0) * np.cos(np.pi * k * unit[..., None]) / k
        return np.asarray(np.einsum("tkc,ij->tkijc", curves, np.eye(3)).reshape(*truth.shape, -1))

    each = tuple(Parameter(f"{axis}_{j}", unit, typical, np.inf) for axis in "xyz" for j in k)
    equation = f"error_i = Σ_k c_ik √2 cos(π k u) / k, u = (v - {low:.6g}) / {high - low:.6g}"
    return Response(
        f"{CURVE}{error} against {driver}", "A curve without a name.", f"{equation}, v {driver}",
        "", "", ("rate",), each, basis, channel=channel, shared=True,
    )  # fmt: skip


def _speed(truth: Truth) -> Array:
    return np.asarray(np.linalg.norm(truth.turning.rate, axis=2))


def _strength(truth: Truth) -> Array:
    return np.asarray(np.linalg.norm(truth.force, axis=2))


def _of(
    driver: str, error: str, words: str, unit: str, typical: float, channel: Channel,
    basis: Callable[[Truth, Context], Array],
) -> tuple[str, Response]:  # fmt: skip
    needs, each = ("order",) if driver == "time" else ("rate",), three("law", unit, typical, np.inf)
    found = Response(
        f"{CURVE}{error} against {driver}, {words}", "A law without a name.",
        f"error_i = c_i h(v), h {words}, v {driver}", "", "", needs,
        each[:1] if unit == "ms" else each, basis, channel=channel,
        lagged=delayed if unit == "ms" else None,
    )  # fmt: skip
    return f"{driver} in {'gyros' if channel == 'angular_rate' else 'accelerometers'}", found


def _by_rate(shape: Shape, most: float) -> Callable[[Truth, Context], Array]:
    return lambda truth, context: own_axis(DEG * shape(truth.turning.rate / most))


def _by_force(shape: Shape, most: float, unit: float) -> Callable[[Truth, Context], Array]:
    return lambda truth, context: own_axis(unit * shape(truth.force / most))


def _offset(shape: Shape, unit: float) -> Callable[[Truth, Context], Array]:
    def basis(truth: Truth, context: Context) -> Array:
        course = unit * shape(context["order"])[:, None, None]
        return own_axis(np.broadcast_to(course, truth.shape))

    return basis


def _scale(shape: Shape, what: str) -> Callable[[Truth, Context], Array]:
    def basis(truth: Truth, context: Context) -> Array:
        seen = truth.turning.rate if what == "rate" else truth.force
        return own_axis(0.01 * shape(context["order"])[:, None, None] * seen)

    return basis


def _place(shape: Shape) -> Callable[[Truth, Context], Array]:
    def basis(truth: Truth, context: Context) -> Array:
        return np.asarray(1e-3 * across(truth) * shape(context["order"])[:, None, None, None])

    return basis


def _delay(shape: Shape) -> Callable[[Truth, Context], Array]:
    def basis(truth: Truth, context: Context) -> Array:
        late = -1e-3 * shape(context["order"])[:, None, None, None]
        return np.asarray(late * truth.turning.spin[..., None])

    return basis
