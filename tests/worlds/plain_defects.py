"""What can be wrong with a bench, a tool or its sensor, in plain numpy: the printed equations of
docs/effects.md written a second time, what no catalogue holds, and forms with a formula.

x is the specific force along the sensor's axes in g, angles are in deg, changes of readings in mg.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Conditions:
    """Of n readings, each (n,): dial angles in deg, °C, share of the run, sides of approach (±1),
    row (from 0); previous : (n, 3) g, of the position before; wait : (n,) how little the sensor
    was waited for; walk : (n, 3); late : (n,) °C, a temperature that trails; count : rows of the
    run; phase : (3,) rad, v : (3,) unit vector, at : a row, all drawn once a world."""

    inclination: Array
    tool_face: Array
    temperature: Array
    order: Array
    approach_i: Array
    approach_t: Array
    row: Array
    previous: Array
    wait: Array
    walk: Array
    late: Array
    count: int
    phase: Array
    v: Array
    at: int


C = Conditions
Angle = Callable[[C, Array], tuple[Array, Array]]
Force = Callable[[Array, C, Array], Array]


def sin(deg: Array) -> Array:
    return np.sin(np.deg2rad(deg))


def cos(deg: Array) -> Array:
    return np.cos(np.deg2rad(deg))


def turned(x: Array, axis: Array, deg: float) -> Array:
    """x turned about unit axes (n, 3), right-handed."""
    along = np.sum(axis * x, axis=1, keepdims=True) * axis
    a = np.deg2rad(deg)
    return along + np.cos(a) * (x - along) + np.sin(a) * np.cross(axis, x)


#: What a search has to find the moment or the place of.
SCANNED = ("bias_step", "scale_step", "inclination_step", "temperature_square")
#: Errors of the dials: name -> number of parameters, and (n,) deg added to inclination, tool-face.
DIALS: dict[str, tuple[int, Angle]] = {
    "inclination_zero": (1, lambda c, p: (p[0] + 0 * c.order, 0 * c.order)),
    "inclination_scale": (1, lambda c, p: (p[0] * c.inclination / 90, 0 * c.order)),
    "inclination_eccentricity": (
        2, lambda c, p: (p[0] * sin(c.inclination) + p[1] * (1 - cos(c.inclination)), 0 * c.order)),
    "inclination_sag": (1, lambda c, p: (p[0] * cos(c.inclination), 0 * c.order)),
    "inclination_wobble": (
        2, lambda c, p: (p[0] * sin(c.tool_face) + p[1] * cos(c.tool_face), 0 * c.order)),
    "inclination_backlash": (1, lambda c, p: (p[0] * c.approach_i, 0 * c.order)),
    "inclination_step": (1, lambda c, p: (p[0] * (c.row >= c.at), 0 * c.order)),
    "tool_face_eccentricity": (
        2, lambda c, p: (0 * c.order, p[0] * sin(c.tool_face) + p[1] * cos(c.tool_face))),
    "tool_face_ellipticity": (
        2, lambda c, p: (0 * c.order, p[0] * sin(2 * c.tool_face) + p[1] * cos(2 * c.tool_face))),
    "tool_face_backlash": (1, lambda c, p: (0 * c.order, p[0] * c.approach_t)),
    "third_harmonic": (1, lambda c, p: (0 * c.order, p[0] * np.sin(
        np.deg2rad(3 * c.tool_face) + c.phase[0]))),
    "slip": (1, lambda c, p: (0 * c.order, p[0] * (c.row >= c.count // 2))),
}  # fmt: skip


def base_tilt_across(x: Array, c: C, p: Array) -> Array:
    t = c.tool_face
    axis = np.stack([cos(t), -sin(t), 0 * t], axis=1)
    return np.cos(np.deg2rad(p[0])) * x + np.sin(np.deg2rad(p[0])) * axis


def axis_non_orthogonality(x: Array, c: C, p: Array) -> Array:
    t = c.tool_face
    return turned(x, np.stack([sin(t), cos(t), 0 * t], axis=1), p[0])


def crept(x: Array, c: C, p: Array) -> Array:
    """Turns about x, then y, then z that grow from minus to plus half of p deg."""
    for axis, deg in zip(np.eye(3), p, strict=True):
        a = np.deg2rad(deg * (c.order - 0.5))[:, None]
        along = (x @ axis)[:, None] * axis
        x = along + np.cos(a) * (x - along) + np.sin(a) * np.cross(axis, x)
    return x


#: Axes of the bench: name -> number of parameters, and the force (n, 3) in g as it truly is.
AXES: dict[str, tuple[int, Force]] = {
    "clamp_creep": (3, crept),
    "base_tilt_across": (1, base_tilt_across),
    "axis_non_orthogonality": (1, axis_non_orthogonality),
}


def cross_axis(x: Array, c: C, p: Array) -> Array:
    xy, xz, yx, yz, zx, zy = p
    a, b, d = x.T
    return np.stack([a * (xy * b + xz * d), b * (yx * a + yz * d), d * (zx * a + zy * b)], axis=1)


def tilted(x: Array, p: Array) -> Array:
    """Of each axis what it sees of the others, the lower triangle first."""
    yx, zx, zy, xy, xz, yz = p
    a, b, d = x.T
    return np.stack([xy * b + xz * d, yx * a + yz * d, zx * a + zy * b], axis=1)


def behind_play(warm: Array, width: float) -> Array:
    """°C of what follows the temperature only where it pushes at either end of a play."""
    found, now = [], warm[0]
    for value in warm:
        now = min(max(now, value - width / 2), value + width / 2)
        found.append(now)
    return np.array(found)


def member(name: str, at: int) -> str:
    """The member of a scan that is planted, of a step before row `at` (from 0); else nothing."""
    if name == "temperature_square":
        return f"{name}@22C"
    return f"{name}@record{at + 1}" if name in SCANNED else ""


def beyond(x: Array, limit: float) -> Array:
    return np.maximum(np.abs(x) - limit, 0.0) / (1.0 - limit)


#: Of the sensor: name -> number of parameters, and (n, 3) mg.
SENSOR: dict[str, tuple[int, Force]] = {
    "temperature_bias": (3, lambda x, c, p: p * (c.temperature - 25)[:, None]),
    "temperature_square": (3, lambda x, c, p: p * ((c.temperature - 22) ** 2)[:, None]),
    "temperature_scale": (3, lambda x, c, p: p * x * (c.temperature - 25)[:, None]),
    "temperature_non_orthogonality": (
        3, lambda x, c, p: tilted(x, np.append(p, np.zeros(3))) * (c.temperature - 25)[:, None]),
    "temperature_misalignment": (
        6, lambda x, c, p: tilted(x, p) * (c.temperature - 25)[:, None]),
    "bias_drift": (3, lambda x, c, p: p * (c.order - 0.5)[:, None]),
    "scale_drift": (3, lambda x, c, p: p * x * (c.order - 0.5)[:, None]),
    "warm_up": (3, lambda x, c, p: p * np.exp(-4 * c.order)[:, None]),
    "bias_step": (3, lambda x, c, p: p * (c.row >= c.at)[:, None]),
    "scale_step": (3, lambda x, c, p: p * x * (c.row >= c.at)[:, None]),
    "hysteresis": (3, lambda x, c, p: p * c.previous),
    "approach_hysteresis": (3, lambda x, c, p: p * np.where(
        np.abs(x - c.previous) > 0.02, np.sign(x - c.previous), 0.0)),
    "quadratic": (3, lambda x, c, p: p * x**2),
    "cubic": (3, lambda x, c, p: p * x**3),
    "asymmetry": (3, lambda x, c, p: p * np.abs(x)),
    "cross_axis": (6, cross_axis),
    "product_across": (3, lambda x, c, p: p * np.roll(x, -1, axis=1) * np.roll(x, 1, axis=1)),
    "squares_across": (3, lambda x, c, p: p * (
        np.roll(x, -1, axis=1) ** 2 - np.roll(x, 1, axis=1) ** 2)),
    # What no catalogue holds.
    "local_sine": (1, lambda x, c, p: p[0] * np.sin(2 * np.pi * x / 0.4 + c.phase)),
    "thermal_lag": (1, lambda x, c, p: p[0] * c.v * (c.late - 25)[:, None]),
    "thermal_play": (1, lambda x, c, p: (
        p[0] * c.v * (behind_play(c.temperature, 6.0) - 25)[:, None])),
    "mixed_third": (1, lambda x, c, p: (
        p[0] * np.array([0.0, 0.0, 1.0]) * (x[:, 0] ** 2 * x[:, 1])[:, None])),
    "thermal_creep": (1, lambda x, c, p: (
        p[0] * c.v * np.cumsum(c.temperature - c.temperature.mean())[:, None])),
    "swing": (1, lambda x, c, p: p[0] * c.v * np.sin(2 * np.pi * c.row / 7.3)[:, None]),
    "supply": (1, lambda x, c, p: p[0] * x * np.sin(2 * np.pi * c.row / 13.3 + 1.0)[:, None]),
    "scale_walk": (1, lambda x, c, p: p[0] * x * c.walk[:, :1]),
    "random_walk": (1, lambda x, c, p: p[0] * c.walk),
    "shock": (1, lambda x, c, p: p[0] * c.v * (
        (c.row >= c.at) * np.exp(-np.maximum(c.row - c.at, 0) / 6))[:, None]),
    "late_reading": (1, lambda x, c, p: p[0] * c.wait[:, None] * (c.previous - x)),
    "pick_up": (1, lambda x, c, p: p[0] * c.v * np.sin(
        np.deg2rad(3 * c.tool_face) + c.phase[0])[:, None]),
    "soft_saturation": (1, lambda x, c, p: -p[0] * np.sign(x) * beyond(x, 0.7) ** 2),
}  # fmt: skip

#: Forms by kind: (numbers) -> f(u).
FORMS: dict[str, Callable[..., Callable[[Array], Array]]] = {
    "sine": lambda period, phase: lambda u: np.sin(2 * np.pi * u / period + phase),
    "power": lambda n, middle, reach: lambda u: ((u - middle) / reach) ** int(n),
    "kink": lambda at: lambda u: np.abs(u - at),
    "step": lambda at: lambda u: 1.0 * (u >= at),
    "saturation": lambda at: lambda u: np.sign(u) * beyond(u, at),
    "soft_saturation": lambda at: lambda u: np.sign(u) * beyond(u, at) ** 2,
    "saw_tooth": lambda period, phase: lambda u: np.mod(u / period + phase, 1.0) - 0.5,
    "exponential": lambda scale, start: lambda u: np.exp(-(u - start) / scale),
}


def form(text: str) -> tuple[str, Angle | Force]:
    """A form by its name "what:driver:kind:number[:number ...]": "dial" or "sensor", and what it
    does at one parameter; what : "bias", "response" or "tool_face"; driver : axes or a covariate"""
    what, driver, kind, *numbers = text.split(":")
    f = FORMS[kind](*(float(n) for n in numbers))
    if what == "tool_face":
        return "dial", lambda c, p: (0 * c.order, p[0] * f(getattr(c, driver)))
    if what == "response":
        mask = np.array([float(a in driver) for a in "xyz"])
        return "sensor", lambda x, c, p: p[0] * mask * f(x)
    return "sensor", lambda x, c, p: p[0] * c.v * f(getattr(c, driver))[:, None]
