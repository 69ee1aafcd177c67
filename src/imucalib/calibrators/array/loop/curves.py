"""Smooth curves without a name, as effects: what an array's errors could follow.

Each is Σ_k c_k √2 cos(π k u) / k of a driver scaled to u = 0..1 over what the motion showed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.loop.motion import BoardMotion
from imucalib.core.context import Context
from imucalib.core.course import delayed
from imucalib.core.effect import Channel, Response
from imucalib.core.parameter import Parameter
from imucalib.core.truth import Truth
from imucalib.estimators.array.samples import turning
from imucalib.units import DEG

Driver = Callable[[Truth, Context], Array]
CURVE = "curve of "  # how the name of a correction without a cause begins
#: Typical size of an unknown curve (m/s² and deg/s), and how many terms it has.
_SIZE, _TERMS = {"acceleration": 0.1, "angular_rate": 0.3}, 4
SENSOR: dict[Channel, str] = {"acceleration": "accelerometer", "angular_rate": "gyroscope"}
#: The same of an IMU that moves on the board (mm) or whose clock does (ms).
_MOVE, _LATE, _SLOW = 0.05, 0.05, 2
_PLACE = "position"


def array_curves(motion: BoardMotion) -> Iterator[tuple[str, Response]]:
    """Driver and curve: each axis' error, alike in all packages, against the size of rate and
    force and against what the axis itself reads; of each IMU by itself against time. Without a
    driver: of one IMU at a time, which stands for "{imu}" in the name."""
    for channel in SENSOR:
        own = ("its own a", "a", _force) if channel == "acceleration" else ("its own ω", "ω", _rate)
        for words, driver, of, shared in (
            ("|ω|", "|ω|", _speed, True),
            ("|a|", "|a|", _strength, True),
            ("time", "time", _time, False),
            (*own, True),
        ):
            yield driver, _curve(channel, words, of, motion, shared)
    for words, of_one in ((_PLACE, _moves), ("gyro delay", _drifts)):
        yield "", of_one(f"{words} of {{imu}} against time")


def _curve(channel: Channel, words: str, of: Driver, motion: BoardMotion, shared: bool) -> Response:
    values = of(motion.truth, motion.context)
    low, high = float(values.min()), float(values.max())
    unit, scale = ("m/s2", 1.0) if channel == "acceleration" else ("deg/s", DEG)

    def basis(truth: Truth, context: Context) -> Array:
        curves = scale * _cosines(of(truth, context), low, high, _TERMS)
        driven = "tkc,ij->tkijc" if curves.ndim == 3 else "tkic,ij->tkijc"  # of each axis
        return np.asarray(np.einsum(driven, curves, np.eye(3)).reshape(*truth.shape, -1))

    each = tuple(
        Parameter(f"{axis}_{k}", unit, _SIZE[channel], np.inf)
        for axis in "xyz"
        for k in range(1, _TERMS + 1)
    )
    equation = (
        f"error_i = Σ_k c_ik √2 cos(π k u) / k, u = (v - {low:.6g}) / {high - low:.6g} in 0..1, "
        f"v = {words} (SI)"
    )
    return Response(
        f"{SENSOR[channel]} error against {words}", "A curve without a name.", equation,
        "the residual", "", each=each, basis=basis, channel=channel, shared=shared,
    )  # fmt: skip


def _moves(name: str) -> Response:
    def basis(truth: Truth, context: Context) -> Array:
        rate, spin = (context.in_common(v)[:, 0] for v in (truth.turning.rate, truth.turning.spin))
        slow = _cosines(context["order"], 0.0, 1.0, _SLOW)
        whole = np.einsum("tij,tc->tijc", 1e-3 * turning(rate, spin), slow)
        return context.in_own(whole.reshape(len(rate), 1, 3, -1))

    each = tuple(
        Parameter(f"{axis}_{k}", "mm", _MOVE, np.inf) for axis in "xyz" for k in range(1, _SLOW + 1)
    )
    equation = "r = r_k + Σ_k c_k √2 cos(π k order) / k, order from 0 to 1"
    return Response(
        name, "An IMU that moves on the board.", equation, "the residual", "", each=each,
        basis=basis,
    )  # fmt: skip


def wander(effect: Response, theta: Array) -> float:
    """m, rms over the motion: how far an IMU moves on the board by a curve of its place with
    parameters (p,), in typical sizes; zero by any other."""
    if effect.each[0].unit != "mm" or not effect.name.startswith(_PLACE):
        return 0.0
    each = 1e-3 * _MOVE * theta.reshape(3, _SLOW) / np.arange(1, _SLOW + 1)
    return float(np.sqrt(np.sum(each**2)))


def _drifts(name: str) -> Response:
    def basis(truth: Truth, context: Context) -> Array:
        curves = -1e-3 * _cosines(context["order"], 0.0, 1.0, _SLOW)
        return np.asarray(truth.turning.spin[..., None] * curves[:, None, None])

    each = tuple(Parameter(f"delay_{k}", "ms", _LATE, np.inf) for k in range(1, _SLOW + 1))
    equation = "y(t) = ω(t - τ), τ = Σ_k c_k √2 cos(π k order) / k, order from 0 to 1"
    return Response(
        name, "A gyro whose clock wanders.", equation, "the residual", "", each=each,
        basis=basis, channel="angular_rate", lagged=delayed,
    )  # fmt: skip


def _speed(truth: Truth, context: Context) -> Array:
    return np.asarray(np.linalg.norm(truth.turning.rate, axis=2))


def _strength(truth: Truth, context: Context) -> Array:
    return np.asarray(np.linalg.norm(truth.force, axis=2))


def _time(truth: Truth, context: Context) -> Array:
    return np.broadcast_to(context["order"][:, None], truth.shape[:2])


def _force(truth: Truth, context: Context) -> Array:
    return truth.force


def _rate(truth: Truth, context: Context) -> Array:
    return truth.turning.rate


def _cosines(values: Array, low: float, high: float, terms: int) -> Array:
    unit = np.clip((values - low) / max(high - low, 1e-300), 0.0, 1.0)
    k = np.arange(1, terms + 1)
    return np.asarray(np.sqrt(2.0) * np.cos(np.pi * k * unit[..., None]) / k)
