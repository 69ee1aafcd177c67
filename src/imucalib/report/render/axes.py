"""Axes of a plot: limits that hold the data, ticks at 1-2-5 steps, labels without noise digits.

Shared by the SVG and the terminal renderer; knows nothing of pixels or characters.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.report.document import Plot, Series

LARGEST = 1e300  # beyond it differences overflow: drawn as a gap
SMALLEST = 1e-290  # below it steps underflow: drawn as zero
SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Axis:
    """Limits in data units (log10 of them where `log`), tick positions and their labels.

    note : what the labels leave out, "×10⁻³" or "+ 9.81"; empty for plain numbers
    """

    low: float
    high: float
    ticks: Array
    labels: tuple[str, ...]
    note: str = ""
    log: bool = False

    def fraction(self, values: Array) -> Array:
        """Position (n,) along the axis, 0 at the low end and 1 at the high end; NaN for a gap."""
        shown = drawable(values, self.log)
        with np.errstate(divide="ignore"):
            shown = np.log10(shown) if self.log else shown
        return np.asarray((shown - self.low) / (self.high - self.low), dtype=np.float64)

    def titled(self, label: str) -> str:
        """The axis label with the note of its tick labels."""
        return f"{label} ({self.note})" if label and self.note else label or self.note


def drawable(values: Array, log: bool = False) -> Array:
    """Values that an axis can show; NaN for the others (NaN, infinite, not positive on a log)."""
    values = np.asarray(values, dtype=np.float64).ravel()
    with np.errstate(invalid="ignore"):
        shown = np.where(np.abs(values) < LARGEST, values, np.nan)
        shown = np.where(np.abs(shown) < SMALLEST, 0.0, shown)
        return np.where(shown > 0, shown, np.nan) if log else shown


def drawable_at_all(series: Series, log: bool) -> bool:
    """Whether any point of the series, or of its band, can be shown."""
    parts = [part for part in (series.y, series.low, series.high) if part is not None]
    x = drawable(series.x)
    return any(bool(np.isfinite(x + drawable(part, log)).any()) for part in parts)


def nice_step(span: float, count: int) -> float:
    """The 1-2-5 step that cuts `span` into at most about `count` parts."""
    raw = span / max(count, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    return next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= raw * (1 - 1e-9))


def linear_axis(low: float, high: float, count: int) -> Axis:
    """A linear axis with about `count` ticks, at least two; `low` < `high`."""
    step = nice_step(high - low, count)
    offset = _offset(low, high, step)
    first = math.ceil((low - offset) / step - 1e-9)
    last = math.floor((high - offset) / step + 1e-9)
    if last <= first:
        return linear_axis(low, high, 2 * count)
    index = np.arange(first, last + 1, dtype=np.float64)
    labels, note = _labels(index, step)
    if offset:
        note = f"{note} + {offset:.15g}".strip().replace("+ -", "− ")
    return Axis(low, high, offset + index * step, labels, note)


def _offset(low: float, high: float, step: float) -> float:
    """What to take off long labels that differ in their last digits only; 0 for ordinary data.

    The roundest number between one span below the axis and its high end.
    """
    largest = max(abs(low), abs(high))
    # Below one, zeros behind the point make a label longer.
    if largest < (1e5 if largest >= 1.0 else 1e4) * step or low <= 0 <= high:
        return 0.0
    start, power = low - (high - low), math.ceil(math.log10(largest))
    while math.ceil(start / 10.0**power) * 10.0**power > high:
        power -= 1
    return float(f"{math.ceil(start / 10.0**power)}e{power}")


def _labels(index: Array, step: float) -> tuple[tuple[str, ...], str]:
    """Tick labels of `index * step` with the decimals of `step`, and their common power of ten."""
    largest = float(np.max(np.abs(index), initial=0)) * step
    power = math.floor(math.log10(largest) + 1e-9) if largest else 0
    exponent = 0 if -2 <= power < 5 else 3 * (power // 3)
    decimals = max(0, exponent - math.floor(math.log10(step) + 1e-9))
    scaled = [k * (step / 10.0**exponent) for k in index]
    labels = tuple(f"{v:.{decimals}f}".replace("-", "−") if v else "0" for v in scaled)
    return labels, f"×10{str(exponent).translate(SUPERSCRIPT)}" if exponent else ""


def log_axis(low: float, high: float, count: int) -> Axis:
    """A logarithmic axis between two log10 limits: decades, with 2 and 5 where there is room."""
    decades = np.arange(math.ceil(low - 1e-9), math.floor(high + 1e-9) + 1, dtype=np.float64)
    if high - low < 0.5:
        plain = linear_axis(10.0**low, 10.0**high, count)
        kept = plain.ticks > 0
        labels = tuple(text for text, keep in zip(plain.labels, kept, strict=True) if keep)
        return Axis(low, high, plain.ticks[kept], labels, plain.note, log=True)
    if high - low < count / 2:
        start = math.floor(low)
        fine = [k + math.log10(m) for k in range(start, math.ceil(high) + 1) for m in (1, 2, 5)]
        exponents = np.array([e for e in fine if low - 1e-9 <= e <= high + 1e-9])
    else:
        stride = max(1, math.ceil(len(decades) / max(count, 1)))
        exponents = decades[decades % stride == 0] if len(decades) else decades
    exponents = exponents[exponents < math.log10(LARGEST)]
    return Axis(low, high, 10.0**exponents, tuple(_log_label(e) for e in exponents), log=True)


def _log_label(exponent: float) -> str:
    if -4 < exponent < 5:
        return f"{10.0**exponent:.4g}"
    power = math.floor(exponent + 1e-9)
    mantissa = round(10.0 ** (exponent - power))
    text = f"10{str(power).translate(SUPERSCRIPT)}"
    return text if mantissa == 1 else f"{mantissa}·{text}"


def limits(parts: Iterable[Array], *, log: bool = False, pad: float = 0.07) -> tuple[float, float]:
    """Low and high of all drawable values, padded; a window around constant data, 0..1 if none."""
    shown = [drawable(part, log) for part in parts]
    values = np.concatenate([part[~np.isnan(part)] for part in shown] or [np.empty(0)])
    if values.size == 0:
        return 0.0, 1.0
    values = np.log10(values) if log else values
    low, high = float(values.min()), float(values.max())
    if high - low <= max(1e-12 * max(abs(low), abs(high)), SMALLEST * 1e3):
        size = max(abs(low), abs(high))
        half = 0.5 if log else 0.1 * size if size > SMALLEST * 1e3 else 1.0
        return low - half, high + half
    margin = pad * (high - low)
    return low - margin, high + margin


def y_parts(plot: Plot) -> list[Array]:
    """Everything the y axis must hold: values, edges, and the foot of bars."""
    parts = [s.y for s in plot.series]
    parts += [edge for s in plot.series for edge in (s.low, s.high) if edge is not None]
    if any(s.mark == "bars" for s in plot.series) and not plot.log_y:
        parts.append(np.zeros(1))
    return parts


def plot_limits(plot: Plot) -> tuple[tuple[float, float], tuple[float, float]]:
    """Limits of x and of y (log10 where logarithmic), before scales are made equal."""
    x_low, x_high = limits([s.x for s in plot.series], pad=0.04)
    y_low, y_high = limits(y_parts(plot), log=plot.log_y)
    slot = bar_slot(plot)
    if slot and not plot.log_y:
        y_low, y_high = _seated(y_parts(plot), y_low, y_high)
    return (x_low - slot / 2, x_high + slot / 2), (y_low, y_high)


def plot_axes(plot: Plot, shape: tuple[float, float], counts: tuple[int, int]) -> tuple[Axis, Axis]:
    """The two axes of a plot.

    shape : width and height of the drawing in one unit of length, used where `plot.equal`
    counts : about how many ticks on x and on y
    """
    (x_low, x_high), (y_low, y_high) = plot_limits(plot)
    if plot.equal and not plot.log_y:
        unit = max((x_high - x_low) / shape[0], (y_high - y_low) / shape[1])
        x_low, x_high = _widened(x_low, x_high, unit * shape[0])
        y_low, y_high = _widened(y_low, y_high, unit * shape[1])
    y_axis = (log_axis if plot.log_y else linear_axis)(y_low, y_high, counts[1])
    return linear_axis(x_low, x_high, counts[0]), y_axis


def _seated(parts: list[Array], low: float, high: float) -> tuple[float, float]:
    """Limits without the margin beyond zero on the side where all bars end: they stand on it."""
    shown = np.concatenate([drawable(part) for part in parts])
    if np.nanmin(shown) >= 0:
        return 0.0, high
    return (low, 0.0) if np.nanmax(shown) <= 0 else (low, high)


def _widened(low: float, high: float, span: float) -> tuple[float, float]:
    spare = max(0.0, span - (high - low)) / 2
    return low - spare, high + spare


def bar_slot(plot: Plot) -> float:
    """Room on x, in data units, that one group of bars may fill; 0 for a plot without bars."""
    bars = [drawable(s.x) for s in plot.series if s.mark == "bars"]
    places = np.unique(np.concatenate([x[~np.isnan(x)] for x in bars])) if bars else np.empty(0)
    if places.size < 2:
        return 0.1 * abs(float(places[0])) or 1.0 if places.size else 0.0
    return float(np.diff(places).min())


def named_places(plot: Plot) -> dict[float, str]:
    """x -> name where every point of every series is named and names agree; else empty."""
    places: dict[float, str] = {}
    for series in plot.series:
        if len(series.names) != len(series.x):
            return {}
        for x, name in zip(series.x.tolist(), series.names, strict=True):
            if not math.isfinite(x) or abs(x) > LARGEST or places.setdefault(x, name) != name:
                return {}
    return places
