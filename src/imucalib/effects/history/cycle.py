"""Bias and scale that swing with a period: once a day, or with what goes on and off in a room."""

from collections.abc import Callable

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Basis, Context, Effect, Family, Parameter, Response, Truth
from imucalib.units import MG

_ROWS, _SECONDS = "rows", "s"
_PER_MILLE = 1e-3  # mg/g
#: Rows of a table from which on more than one swing can be told from all else.
_FEWEST = 20
#: Swings of a table: at least one and a half, else it is a drift, and at most this many a row;
#: steps of half a swing a table, between which a wave keeps nine tenths of its amplitude.
_SLOWEST, _QUICKEST, _STEP = 1.5, 0.4, 0.5
_FINER = 5
#: Spread of the steps of time, relative, from which a pace is uneven; and how many swings a row can
#: be told then, where an even pace takes a quick one for a slow one.
_PACE, _UNEVEN = 0.2, 0.8


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


def _gain(value: str) -> tuple[Basis, Basis]:
    """Cosine and sine of a scale that all axes share, and their derivative by the force."""

    def waves(context: Context) -> Array:
        angle = phase_of(value, context)
        return _PER_MILLE * np.stack([np.cos(angle), np.sin(angle)], axis=-1)[:, None, None]

    def basis(truth: Truth, context: Context) -> Array:
        return np.asarray(truth.force[..., None] * waves(context))

    def slope(truth: Truth, context: Context) -> Array:
        each = waves(context)[..., None] * np.eye(3)[:, None]
        return np.broadcast_to(each, (*truth.shape, 2, 3))

    return basis, slope


def _sizes(name: str, unit: str, typical: float, plausible: float) -> tuple[Parameter, ...]:
    return tuple(
        Parameter(f"{name}_{w}_{a}", unit, typical, plausible)
        for w in ("cos", "sin")
        for a in "xyz"
    )


def scale_cycle(value: str) -> Effect:
    """The same of the scale of all axes together; ValueError where `value` is no period."""
    driver, words, counted = _described(value)
    basis, slope = _gain(value)
    return Response(
        f"scale_cycle@{value}",
        f"The scale of all axes swings with a period of {words}.",
        f"y_i = x_i (1 + c cos(φ) + s sin(φ)),  φ = 2π {counted} / period",
        "an output that follows its supply, practice",
        "Note the supply's voltage beside each position.",
        (driver, "tool_face"),
        each=tuple(
            Parameter(f"scale_cycle_{value}_{wave}", "mg/g", 1.0, 50.0) for wave in ("cos", "sin")
        ),
        basis=basis,
        basis_dx=slope,
        shared=True,
        stage="fixture",
    )


def _described(value: str) -> tuple[str, str, str]:
    """What a period is counted in, the period in words, and its time; ValueError otherwise."""
    driver, unit = _driver_of(value)
    period = float(value.removesuffix(unit))
    if not period > 0.0:
        raise ValueError(f"no period: {value}")
    if unit == _ROWS:
        return driver, f"{period:g} rows", "(row - 1)"
    return driver, f"{period:g} s", "time"


def cycle(value: str) -> Effect:
    """The swing with a period of so many rows of a table, "7.3rows", or of so many seconds by its
    clock, "220s"; ValueError otherwise."""
    driver, words, counted = _described(value)
    return Response(
        f"cycle@{value}",
        f"The bias swings with a period of {words}.",
        f"y_i = x_i + c_i cos(φ) + s_i sin(φ),  φ = 2π {counted} / period",
        "heating or a pump that goes on and off beside a bench, practice",
        "Repeat one position at an uneven pace, and note the time and the temperature.",
        (driver, "tool_face"),
        each=_sizes(f"cycle_{value}", "mg", 1.0, 50.0),
        basis=_bias(lambda context: phase_of(value, context)),
        # Of the room and not of the sensor: no recording has its phase.
        stage="fixture",
    )


def phase_of(value: str, context: Context) -> Array:
    """(n,) rad of the swing "7.3rows" or "220s"; ValueError otherwise."""
    driver, unit = _driver_of(value)
    return np.asarray(2.0 * np.pi * context[driver] / float(value.removesuffix(unit)))


def _driver_of(value: str) -> tuple[str, str]:
    """What a period is counted in, and its unit."""
    for driver, unit in (("record", _ROWS), ("time", _SECONDS)):
        if value.endswith(unit) and value.removesuffix(unit)[-1:].isdigit():
            return driver, unit
    raise ValueError(f"no period in rows or seconds: {value}")


def _periods(swings: Array, span: float, unit: str) -> tuple[str, ...]:
    return tuple(f"{span / s:.4g}{unit}" for s in swings)


def _values(context: Context) -> tuple[str, ...]:
    if context.n < _FEWEST or "record" not in context or "tool_face" not in context:
        return ()
    span, unit = _span(context)
    most = (_QUICKEST if unit == _ROWS else _UNEVEN) * _rows(context)
    return _periods(np.arange(_SLOWEST, most, _STEP), span, unit)


def _nearby(context: Context, value: str) -> tuple[str, ...]:
    _, unit = _driver_of(value)
    span = float(_rows(context)) if unit == _ROWS else float(np.ptp(context["time"]))
    swings = span / float(value.removesuffix(unit))
    return _periods(swings + _STEP * np.linspace(-1.0, 1.0, 2 * _FINER + 1), span, unit)


def _span(context: Context) -> tuple[float, str]:
    """How long the table is, by its clock where its rows stand at an uneven pace."""
    if "time" in context:
        steps = np.diff(np.sort(context["time"]))
        if steps.size and np.std(steps) > _PACE * np.mean(steps) > 0.0:
            return float(np.ptp(context["time"])), _SECONDS
    return float(_rows(context)), _ROWS


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
    Family(
        "scale_cycle",
        "The scale of all axes swings with a period.",
        "7.3rows",
        scale_cycle,
        _values,
        _nearby,
        unfounded=True,
    ),
)
