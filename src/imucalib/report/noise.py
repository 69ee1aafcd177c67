"""The noise of what is still: a row an axis, with what the recording is too short to show."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from imucalib.inspection.noise import AxisNoise, Coefficient, SensorNoise
from imucalib.report.document import Block, Plot, Section, Series, Table, Text
from imucalib.significant_digits import with_sd
from imucalib.units import DEG, MG

_TERMS = ("white", "instability", "walk", "ramp")
#: Of each quantity: unit of white noise, instability, walk and ramp, and SI in one of it.
_UNITS = {
    "acceleration": (
        ("µg/√Hz", 1e-3 * MG), ("µg", 1e-3 * MG), ("µg/s/√Hz", 1e-3 * MG),
        ("µg/h", 1e-3 * MG / 3600.0),
    ),
    "angular_rate": (
        ("deg/√h", DEG / 60.0), ("deg/h", DEG / 3600.0), ("deg/h/√h", DEG / 3600.0 / 60.0),
        ("deg/h/h", DEG / 3600.0**2),
    ),
}  # fmt: skip
_NOTE = (
    "White noise N, bias instability B, random walk K and ramp R of the overlapping Allan variance "
    "N²/τ + 0.441 B² + K² τ/3 + R² τ²/2, ± one standard deviation. <: what it lies below with 95 % "
    "probability, the recording being too short, or too quiet in it, to show it; -: anything. An "
    "axis with < and three - has noise of another shape, such as lines in its spectrum."
)


def noise_section(noise: Sequence[SensorNoise]) -> Section:
    """A table and a plot for each kind of sensor."""
    if not noise:
        words = "Nothing is still for long enough to tell the noise: record at rest for a minute."
        return Section("Noise at rest", (Text(words, "warning"),))
    blocks: list[Block] = []
    for quantity, units in _UNITS.items():
        own = [n for n in noise if n.quantity == quantity]
        if not own:
            continue
        header = ("axis", *(f"{t}, {u}" for t, (u, _) in zip(_TERMS, units, strict=True)))
        rows = [_row(sensor, k) for sensor in own for k in range(len(sensor.axes))]
        curve = own[0].axes[0].curve
        title = (
            f"{own[0].quantity.replace('_', ' ')}: {curve.seconds:.0f} s at rest, "
            f"{curve.longest:.0f} s at a time"
        )
        note = "" if blocks else _NOTE
        blocks.append(Table(title, header, tuple(rows), "lrrrr", note))
        blocks.append(_plot(own))
    return Section("Noise at rest", tuple(blocks))


def _row(sensor: SensorNoise, k: int) -> tuple[str, ...]:
    cells = [
        _cell(getattr(sensor.axes[k], term), scale)
        for term, (_, scale) in zip(_TERMS, _UNITS[sensor.quantity], strict=True)
    ]
    return (f"{sensor.triad} {'xyz'[k]}", *cells)


def _cell(found: Coefficient, scale: float) -> str:
    if found.value is not None and found.sd is not None:
        value, sd = with_sd(found.value / scale, found.sd / scale)
        return f"{value} ± {sd}"
    return "-" if found.bound is None else f"< {float(f'{found.bound / scale:.2g}'):.9g}"


def _plot(sensors: Sequence[SensorNoise]) -> Plot:
    """The noisiest axis of every sensor."""
    series = []
    for sensor in sensors:
        worst = max(sensor.axes, key=lambda axis: float(axis.white.value or 0.0))
        low, high = worst.curve.interval()
        scale = MG if sensor.unit == "m/s2" else DEG
        x = np.log10(worst.curve.tau)
        ends = (low / scale, high / scale)
        series.append(Series(sensor.triad, x, worst.curve.deviation / scale, "line", *ends))
    unit = "mg" if sensors[0].unit == "m/s2" else "deg/s"
    name = sensors[0].quantity.replace("_", " ")
    caption = "Overlapping Allan deviation of each sensor's noisiest axis."
    return Plot(f"Allan deviation, {name}", "log10 τ, s", unit, tuple(series), caption, log_y=True)


def noise_dict(noise: Sequence[SensorNoise]) -> list[dict[str, Any]]:
    """In SI and plain types; null where the recording does not show it."""
    return [
        {
            "triad": sensor.triad,
            "quantity": sensor.quantity,
            "unit": sensor.unit,
            "rate_hz": sensor.rate,
            "axis": "xyz"[k],
            **{term: _numbers(getattr(axis, term)) for term in _TERMS},
            "fitted_from_s": axis.start,
            "allan": _curve(axis),
        }
        for sensor in noise
        for k, axis in enumerate(sensor.axes)
    ]


def _numbers(found: Coefficient) -> dict[str, float | None]:
    return {"value": found.value, "sd": found.sd, "below": found.bound}


def _curve(axis: AxisNoise) -> dict[str, Any]:
    low, high = axis.curve.interval()
    return {
        "tau_s": axis.curve.tau.tolist(),
        "deviation": axis.curve.deviation.tolist(),
        "low": low.tolist(),
        "high": high.tolist(),
    }
