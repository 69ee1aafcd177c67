"""What can be wrong with a bench, a tool or its sensor, in plain numpy: the printed equations of
the effects written a second time, and what no catalogue holds.

x is the specific force along the sensor's axes in g, angles are in deg, changes of readings in mg.
Each entry is (number of parameters, largest credible parameter, function): a draw that would need
more than the largest to reach its strength is no world that anyone meets.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Conditions:
    """Of n readings, each (n,): dial angles (deg), temperature and the temperature that trails it
    (degC), order from 0 to 1, row from 0, hour of the day, sides of approach to a setting (-1, 1);
    previous : (n, 3) g, what the sensor felt before; walk : (n, 3), a random walk of unit size.
    Drawn once a world: phase (3,) rad, v (3,) unit vector, at : a row, middle : degC."""

    inclination: Array
    tool_face: Array
    temperature: Array
    late: Array
    order: Array
    row: Array
    hour: Array
    approach_i: Array
    approach_t: Array
    previous: Array
    walk: Array
    phase: Array
    v: Array
    at: float
    middle: float

    def take(self, rows: NDArray[np.intp]) -> Conditions:
        """The conditions of some rows."""
        picked = {name: getattr(self, name)[rows] for name in _BY_ROW}
        return replace(self, **picked)


_BY_ROW = (
    "inclination",
    "tool_face",
    "temperature",
    "late",
    "order",
    "row",
    "hour",
    "approach_i",
    "approach_t",
    "previous",
    "walk",
)
C = Conditions
Angle = Callable[[C, Array], tuple[Array, Array]]
Force = Callable[[Array, C, Array], Array]


def sin(deg: Array) -> Array:
    """Sine of degrees."""
    return np.asarray(np.sin(np.deg2rad(deg)))


def cos(deg: Array) -> Array:
    """Cosine of degrees."""
    return np.asarray(np.cos(np.deg2rad(deg)))


def direction(i: Array, t: Array) -> Array:
    """(n, 3) g in the tool's frame at inclination and tool-face."""
    return np.stack([cos(i) * sin(t), cos(i) * cos(t), sin(i)], axis=-1)


def turned(x: Array, axis: Array, deg: Array) -> Array:
    """x (n, 3) turned about unit axes (n, 3) or (3,), right-handed."""
    along = np.sum(axis * x, axis=1, keepdims=True) * axis
    a = np.deg2rad(deg)[:, None]
    return np.asarray(along + np.cos(a) * (x - along) + np.sin(a) * np.cross(axis, x))


def turns(x: Array, deg: Array) -> Array:
    """x turned about x, then y, then z by deg (n, 3)."""
    for axis, by in zip(np.eye(3), deg.T, strict=True):
        x = turned(x, axis, by)
    return x


#: Errors of the dials: (n,) deg added to inclination and to tool-face.
DIALS: dict[str, tuple[int, float, Angle]] = {
    "inclination_zero": (1, 3.0, lambda c, p: (p[0] + 0 * c.order, 0 * c.order)),
    "inclination_scale": (1, 3.0, lambda c, p: (p[0] * c.inclination / 90, 0 * c.order)),
    "inclination_sag": (1, 2.0, lambda c, p: (p[0] * cos(c.inclination), 0 * c.order)),
    "inclination_eccentricity": (
        2,
        2.0,
        lambda c, p: (p[0] * sin(c.inclination) + p[1] * (1 - cos(c.inclination)), 0 * c.order),
    ),
    "inclination_wobble": (
        2,
        2.0,
        lambda c, p: (p[0] * sin(c.tool_face) + p[1] * cos(c.tool_face), 0 * c.order),
    ),
    "inclination_backlash": (1, 2.0, lambda c, p: (p[0] * c.approach_i, 0 * c.order)),
    "tool_face_eccentricity": (
        2,
        2.0,
        lambda c, p: (0 * c.order, p[0] * sin(c.tool_face) + p[1] * cos(c.tool_face)),
    ),
    "tool_face_ellipticity": (
        2,
        2.0,
        lambda c, p: (0 * c.order, p[0] * sin(2 * c.tool_face) + p[1] * cos(2 * c.tool_face)),
    ),
    "tool_face_backlash": (1, 2.0, lambda c, p: (0 * c.order, p[0] * c.approach_t)),
}


def base_tilt_across(x: Array, c: C, p: Array) -> Array:
    """Gravity has a part along the inclination axis, which turns with the tool-face."""
    axis = np.stack([cos(c.tool_face), -sin(c.tool_face), 0 * c.order], axis=1)
    return np.asarray(np.cos(np.deg2rad(p[0])) * x + np.sin(np.deg2rad(p[0])) * axis)


def axis_non_orthogonality(x: Array, c: C, p: Array) -> Array:
    """A turn about the direction square to both axes."""
    axis = np.stack([sin(c.tool_face), cos(c.tool_face), 0 * c.order], axis=1)
    return turned(x, axis, p[0] + 0 * c.order)


#: Axes of the bench and the clamp: the force (n, 3) in g as it truly is.
AXES: dict[str, tuple[int, float, Force]] = {
    "base_tilt_across": (1, 2.0, base_tilt_across),
    "axis_non_orthogonality": (1, 2.0, axis_non_orthogonality),
    "clamp_creep": (3, 3.0, lambda x, c, p: turns(x, p * (c.order - 0.5)[:, None])),
}


def cross_axis(x: Array, c: C, p: Array) -> Array:
    """The scale of an axis depends on the force across it."""
    xy, xz, yx, yz, zx, zy = p
    a, b, d = x.T
    return np.stack([a * (xy * b + xz * d), b * (yx * a + yz * d), d * (zx * a + zy * b)], axis=1)


def daily(c: C, p: Array) -> Array:
    """(n, 3), a swing once a day: three cosines, three sines."""
    a = 2 * np.pi * c.hour[:, None] / 24
    return np.asarray(p[:3] * np.cos(a) + p[3:] * np.sin(a))


def side(x: Array, c: C) -> Array:
    """(n, 3), the side from which each axis came, where it came from anywhere."""
    return np.where(np.abs(x - c.previous) > 0.02, np.sign(x - c.previous), 0.0)


def excess(c: C) -> Array:
    """(n, 1) degC above 25."""
    return (c.temperature - 25.0)[:, None]


#: Of the sensor: (n, 3) mg.
SENSOR: dict[str, tuple[int, float, Force]] = {
    "temperature_bias": (3, 3.0, lambda x, c, p: p * excess(c)),
    "temperature_scale": (3, 3.0, lambda x, c, p: p * x * excess(c)),
    "bias_drift": (3, 60.0, lambda x, c, p: p * (c.order - 0.5)[:, None]),
    "scale_drift": (3, 60.0, lambda x, c, p: p * x * (c.order - 0.5)[:, None]),
    "warm_up": (3, 60.0, lambda x, c, p: p * np.exp(-4 * c.order)[:, None]),
    "bias_step": (3, 60.0, lambda x, c, p: p * (c.row >= c.at)[:, None]),
    "time_of_day": (6, 20.0, lambda x, c, p: daily(c, p)),
    "thermal_lag": (3, 3.0, lambda x, c, p: p * (c.late - 25.0)[:, None]),
    "hysteresis": (3, 40.0, lambda x, c, p: p * c.previous),
    "approach_hysteresis": (3, 40.0, lambda x, c, p: p * side(x, c)),
    "quadratic": (3, 60.0, lambda x, c, p: p * x**2),
    "cubic": (3, 60.0, lambda x, c, p: p * x**3),
    "asymmetry": (3, 60.0, lambda x, c, p: p * np.abs(x)),
    "cross_axis": (6, 60.0, cross_axis),
}


def beyond(x: Array, limit: float) -> Array:
    """0 up to the limit, 1 at 1 g."""
    return np.asarray(np.maximum(np.abs(x) - limit, 0.0) / (1.0 - limit), float)


def squares(c: C) -> Array:
    """(n, 1) of -1 and 1: what switches at random moments, a relay or a supply."""
    edges = np.sort((c.phase[:, None] * np.array([[0.37, 1.21, 2.53]]) % 1.0).ravel())
    odd = np.searchsorted(edges, c.order) % 2
    return np.where(odd, -1.0, 1.0)[:, None]


def thermal_loop(c: C) -> Array:
    """(n, 1): another value on the way up than on the way down, largest amid the range."""
    rising = np.sign(c.temperature - c.late)
    return (rising * np.exp(-(((c.temperature - c.middle) / 3.0) ** 2)))[:, None]


#: What no catalogue holds; parameters as above.
OUTSIDE_SENSOR: dict[str, tuple[int, float, Force]] = {
    "local_sine": (
        1,
        40.0,
        lambda x, c, p: (
            p[0] * np.sin(2 * np.pi * x / 0.21 + c.phase) * np.exp(-(((x - 0.35) / 0.3) ** 2))
        ),
    ),
    "soft_saturation": (1, 80.0, lambda x, c, p: -p[0] * np.sign(x) * beyond(x, 0.6) ** 2),
    "hard_saturation": (1, 80.0, lambda x, c, p: -p[0] * np.sign(x) * beyond(x, 0.75)),
    "fourth_order": (3, 80.0, lambda x, c, p: p * x**4),
    "square_wave": (1, 40.0, lambda x, c, p: p[0] * c.v * squares(c)),
    "thermal_loop": (1, 40.0, lambda x, c, p: p[0] * c.v * thermal_loop(c)),
    "mixed_third": (1, 60.0, lambda x, c, p: p[0] * c.v * np.prod(x, axis=1)[:, None]),
    "scale_walk": (1, 60.0, lambda x, c, p: p[0] * x * c.walk[:, :1]),
    "swing": (1, 40.0, lambda x, c, p: p[0] * c.v * np.sin(14.7 * c.order + c.phase[0])[:, None]),
}
OUTSIDE_DIALS: dict[str, tuple[int, float, Angle]] = {
    "third_harmonic": (
        1,
        2.0,
        lambda c, p: (0 * c.order, p[0] * np.sin(np.deg2rad(3 * c.tool_face) + c.phase[0])),
    ),
    "worn_gear": (
        1,
        2.0,
        lambda c, p: (p[0] * np.exp(-(((c.inclination - 20.0) / 12.0) ** 2)), 0 * c.order),
    ),
}
EVERY_DIAL = {**DIALS, **OUTSIDE_DIALS}
EVERY_SENSOR = {**SENSOR, **OUTSIDE_SENSOR}
NUMBER = {n: e[0] for n, e in (*EVERY_DIAL.items(), *AXES.items(), *EVERY_SENSOR.items())}
LARGEST = {n: e[1] for n, e in (*EVERY_DIAL.items(), *AXES.items(), *EVERY_SENSOR.items())}
