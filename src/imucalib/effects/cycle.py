"""Bias and scale that swing with a period: once a day, or with what goes on and off in a room."""

from collections.abc import Callable

import numpy as np

from imucalib.arrays import Array
from imucalib.core.context import Context
from imucalib.core.effect import Basis, Effect, Family, Response
from imucalib.core.parameter import Parameter
from imucalib.core.truth import Truth
from imucalib.units import MG

_ROWS = "rows"
_PER_MILLE = 1e-3  # mg/g
#: Rows of a table from which on more than one swing can be told from all else.
_FEWEST = 20
#: Swings of a table: at least one and a half, else it is a drift, and at most this many a row;
#: steps of half a swing a table, between which a wave keeps nine tenths of its amplitude.
_SLOWEST, _QUICKEST, _STEP = 1.5, 0.4, 0.5
_FINER = 5


def _waves(angle: Array) -> Array:
    """(n, 1, 3, 6) cosine and sine of each axis."""
    waves = np.stack([np.cos(angle), np.sin(angle)])[:, :, None, None, None]
    return np.concatenate([np.eye(3) * waves[0], np.eye(3) * waves[1]], axis=-1)


def _bias(angle: Callable[[Context], Array]) -> Basis:
    def basis(truth: Truth, context: Context) -> Array:
        return np.broadcast_to(MG * _waves(angle(context)), (*truth.shape, 6))

    return basis


def _scale(truth: Truth, context: Context) -> Array:
    return np.asarray(truth.force[..., None] * (_PER_MILLE * _waves(context["time_of_day"])))


def _scale_dx(truth: Truth, context: Context) -> Array:
    each = (_PER_MILLE * _waves(context["time_of_day"]))[..., None] * np.eye(3)[:, None]
    return np.broadcast_to(each, (*truth.shape, 6, 3))


def _sizes(name: str, unit: str, typical: float, plausible: float) -> tuple[Parameter, ...]:
    return tuple(
        Parameter(f"{name}_{w}_{a}", unit, typical, plausible)
        for w in ("cos", "sin")
        for a in "xyz"
    )


def cycle(value: str) -> Effect:
    """The swing with a period of so many rows of a table, "7.3rows"; ValueError otherwise."""
    rows = float(value.removesuffix(_ROWS))
    if not value.endswith(_ROWS) or not rows > 0.0:
        raise ValueError(f"no period in rows: {value}")
    return Response(
        f"cycle@{value}",
        f"The bias swings with a period of {rows:g} rows.",
        "y_i = x_i + c_i cos(φ) + s_i sin(φ),  φ = 2π (row - 1) / period",
        "heating or a pump that goes on and off beside a bench, practice",
        "Repeat one position at an uneven pace, and note the time and the temperature.",
        ("record", "tool_face"),
        each=_sizes(f"cycle_{value}", "mg", 1.0, 50.0),
        basis=_bias(lambda context: 2.0 * np.pi * context["record"] / rows),
        # Of the room and not of the sensor: no recording has its phase.
        stage="fixture",
    )


def _periods(swings: Array, rows: int) -> tuple[str, ...]:
    return tuple(f"{rows / s:.4g}{_ROWS}" for s in swings)


def _values(context: Context) -> tuple[str, ...]:
    if context.n < _FEWEST or "record" not in context or "tool_face" not in context:
        return ()
    rows = _rows(context)
    return _periods(np.arange(_SLOWEST, _QUICKEST * rows, _STEP), rows)


def _nearby(context: Context, value: str) -> tuple[str, ...]:
    rows = _rows(context)
    swings = rows / float(value.removesuffix(_ROWS))
    return _periods(swings + _STEP * np.linspace(-1.0, 1.0, 2 * _FINER + 1), rows)


def _rows(context: Context) -> int:
    return int(context["record"].max()) + 1


EFFECTS = (
    Response(
        "time_of_day",
        "The bias swings once a day.",
        "y_i = x_i + c_i cos(φ) + s_i sin(φ),  φ = 2π time of day",
        "stands in for the temperature where none was recorded",
        "Record several days, and the temperature.",
        ("time_of_day",),
        each=_sizes("daily", "mg", 0.3, 20.0),
        basis=_bias(lambda context: context["time_of_day"]),
    ),
    Response(
        "scale_by_time_of_day",
        "The scale factor swings once a day.",
        "y_i = x_i (1 + c_i cos(φ) + s_i sin(φ)),  φ = 2π time of day",
        "stands in for the temperature where none was recorded",
        "Record several days, and the temperature.",
        ("time_of_day",),
        each=_sizes("daily_scale", "mg/g", 0.3, 20.0),
        basis=_scale,
        basis_dx=_scale_dx,
    ),
)

FAMILIES = (
    Family(
        "cycle",
        "The bias swings with a period.",
        "7.3rows",
        cycle,
        _values,
        _nearby,
        unfounded=True,
    ),
)
