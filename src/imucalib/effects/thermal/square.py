"""A bias that turns at a temperature: what is left of a sensor whose linear part was trimmed.

About any other temperature the square has a linear part as well, which `temperature_bias` holds:
where both are taken, the turning point of each axis follows from the two.
"""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Effect, Family, Response, three
from imucalib.effects.covariate import bias_with

#: Where a turning point is tried, in parts of the range: at an end it is nearly a linear bias.
_PARTS = (0.25, 0.5, 0.75)
#: °C between two turning points that are tried, at first and near the best one.
_COARSE, _FINE = 1.0, 0.2
#: What a line leaves of the square, in ranges squared, from which on the two can be told apart:
#: 0.075 of temperatures spread evenly, 0.04 of two that are each held within a twentieth.
_BENT = 0.05


def turning_point(value: str) -> float:
    """°C of "22C"; ValueError otherwise."""
    if not value.endswith("C"):
        raise ValueError(f"no temperature in °C: {value}")
    return float(value.removesuffix("C"))


def temperature_square(value: str) -> Effect:
    """About the turning point given as "22C"; ValueError otherwise."""
    at = turning_point(value)
    return Response(
        f"temperature_square@{value}",
        f"The bias follows the square of the temperature, about {at:g} °C.",
        "y_i = x_i + c_i (T - T_0)²",
        "second-order temperature coefficient of bias, IEEE Std 1293",
        "Record the temperature, over a wide range and in varied attitudes.",
        ("temperature",),
        each=three(f"square_{value}", "mg/degC2", 0.02, 2.0),
        basis=bias_with(lambda context: (context["temperature"] - at) ** 2),
    )


def _values(context: Context) -> tuple[str, ...]:
    if "temperature" not in context:
        return ()
    low, high = np.min(context["temperature"]), np.max(context["temperature"])
    if not high > low or _bend((context["temperature"] - low) / (high - low)) < _BENT:
        return ()
    points = np.round((low + np.array(_PARTS) * (high - low)) / _COARSE) * _COARSE
    inside = np.unique(points[(points > low) & (points < high)])
    return tuple(f"{point:g}C" for point in inside)


def _bend(share: Array) -> float:
    """What a line leaves of the square of the temperature, (n,) in parts of its range."""
    line = np.stack([np.ones_like(share), share], axis=1)
    left = share**2 - line @ np.linalg.lstsq(line, share**2, rcond=None)[0]
    return float(np.std(left))


def _nearby(context: Context, value: str) -> tuple[str, ...]:
    at, reach = turning_point(value), _PARTS[0] * float(np.ptp(context["temperature"]))
    steps = np.arange(1, int(reach / _FINE) + 1) * _FINE
    return tuple(f"{at + step:.4g}C" for step in np.concatenate([-steps[::-1], [0.0], steps]))


FAMILIES = (
    Family(
        "temperature_square",
        "The bias turns at a temperature.",
        "22C",
        temperature_square,
        _values,
        _nearby,
    ),
)
