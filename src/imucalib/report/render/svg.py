"""A plot as SVG: own drawing, small, without scripts or fonts, for light and dark backgrounds.

Text and axes use `currentColor`; series take the CSS variables `--series-0` ... `--series-6`, with
the palette of Okabe and Ito (colour universal design, 2008) as fallback.

Axes: limits that hold the data, ticks at 1-2-5 steps, labels without noise digits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import count
from typing import TYPE_CHECKING

import numpy as np

from imucalib.arrays import Array
from imucalib.report.render import marks
from imucalib.report.render.document import Plot, Series
from imucalib.report.render.marks import Shape, clip, text_width
from imucalib.report.render.templates import fill, short

if TYPE_CHECKING:
    from markupsafe import Markup

LARGEST = 1e300  # beyond it differences overflow: drawn as a gap
SMALLEST = 1e-290  # below it steps underflow: drawn as zero
SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "currentColor")
FONT = 12.5
DASHED = 200  # points of a line that may be dashed: a longer one is too ragged for it
DASHES = ("", "7 3", "2 3", "8 3 2 3", "12 4", "4 2 1 2 1 2")
WIDTH, HEIGHT = 600, 330
LEGEND_ROW = 20.0
SWATCH = 26.0
#: Colours that mean the same on every page: the reading as it came, before the search, after it.
_ROLES = {
    **dict.fromkeys(("raw", "raw reading", "as read"), 0),
    **dict.fromkeys(("before", "alone"), 1),
    **dict.fromkeys(("after", "corrected", "with the fleet"), 2),
}
#: Colour of the series (None: that of the text), and what is drawn in it.
Group = tuple[int | None, list[Shape]]


@dataclass(frozen=True)
class Axis:
    """Limits in data units (log10 of them where `log`), tick positions and their labels.

    note : what the labels leave out, such as "×10⁻³"; empty for plain numbers
    """

    low: float
    high: float
    ticks: Array
    labels: tuple[str, ...]
    note: str = ""
    log: bool = False

    def fraction(self, values: Array) -> Array:
        """Position (n,) along the axis, 0 at the low end and 1 at the high end; NaN for a gap."""
        shown = mask(values, self.log)
        with np.errstate(divide="ignore"):
            shown = np.log10(shown) if self.log else shown
        return np.asarray((shown - self.low) / (self.high - self.low), dtype=np.float64)

    def full_label(self, label: str) -> str:
        """The axis label with the note of its tick labels."""
        return f"{label} ({self.note})" if label and self.note else label or self.note


def mask(values: Array, log: bool = False) -> Array:
    """Values that an axis can show; NaN for the others (NaN, infinite, not positive on a log)."""
    values = np.asarray(values, dtype=np.float64).ravel()
    with np.errstate(invalid="ignore"):
        shown = np.where(np.abs(values) < LARGEST, values, np.nan)
        shown = np.where(np.abs(shown) < SMALLEST, 0.0, shown)
        return np.where(shown > 0, shown, np.nan) if log else shown


def nice_step(span: float, count: int) -> float:
    """The 1-2-5 step that cuts `span` into at most about `count` parts."""
    raw = span / max(count, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    return next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= raw * (1 - 1e-9))


def linear_axis(low: float, high: float, count: int, whole: bool = False) -> Axis:
    """A linear axis with about `count` ticks, at least two; `low` < `high`.

    whole : of things that are counted: no tick between two numbers, be there one only
    """
    step = max(nice_step(high - low, count), float(whole))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    if last <= first and not whole:
        return linear_axis(low, high, 2 * count)
    index = np.arange(first, last + 1, dtype=np.float64)
    return Axis(low, high, index * step, *_labels(index, step))


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
    """A logarithmic axis between two log10 limits: decades, with 2 and 5 where there is room, and
    even steps where those are too few."""
    decades = np.arange(math.ceil(low - 1e-9), math.floor(high + 1e-9) + 1, dtype=np.float64)
    start = math.floor(low)
    fine = [k + math.log10(m) for k in range(start, math.ceil(high) + 1) for m in (1, 2, 5)]
    exponents = np.array([e for e in fine if low - 1e-9 <= e <= high + 1e-9])
    if len(exponents) < 3:  # no one would see that the axis is logarithmic
        plain = linear_axis(10.0**low, 10.0**high, count)
        kept = plain.ticks > 0
        labels = tuple(text for text, keep in zip(plain.labels, kept, strict=True) if keep)
        return Axis(low, high, plain.ticks[kept], labels, plain.note, log=True)
    if high - low >= count / 2:
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
    shown = [mask(part, log) for part in parts]
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


def plot_limits(plot: Plot) -> tuple[tuple[float, float], tuple[float, float]]:
    """Limits of x and of y (log10 where logarithmic), before scales are made equal."""
    parts = [part for s in plot.series for part in (s.y, s.low, s.high) if part is not None]
    return limits([s.x for s in plot.series], pad=0.04), limits(parts, log=plot.log_y)


def plot_axes(plot: Plot, shape: tuple[float, float], counts: tuple[int, int]) -> tuple[Axis, Axis]:
    """The two axes of a plot.

    shape : width and height of the drawing in one unit of length, used where `plot.equal`
    counts : about how many ticks on x and on y
    """
    (x_low, x_high), (y_low, y_high) = plot_limits(plot)
    if plot.equal and not plot.log_y:
        unit = max((x_high - x_low) / shape[0], (y_high - y_low) / shape[1])
        x_low, x_high = _widen(x_low, x_high, unit * shape[0])
        y_low, y_high = _widen(y_low, y_high, unit * shape[1])
    y_axis = (log_axis if plot.log_y else linear_axis)(y_low, y_high, counts[1])
    shown = [mask(s.x) for s in plot.series]
    whole = all(np.all(np.isnan(x) | (x == np.round(x))) for x in shown)
    return linear_axis(x_low, x_high, counts[0], whole), y_axis


def _widen(low: float, high: float, span: float) -> tuple[float, float]:
    spare = max(0.0, span - (high - low)) / 2
    return low - spare, high + spare


@dataclass(frozen=True)
class AxesFrame:
    """The rectangle of the axes in pixels, and the axes that it carries."""

    left: float
    top: float
    width: float
    height: float
    x: Axis
    y: Axis

    def place(self, series: Series) -> marks.Placed:
        """A series in pixels."""
        x = self.left + self.width * self.x.fraction(series.x)
        edges = [None if e is None else self._edge(e) for e in (series.low, series.high)]
        titles = marks.hover_titles(series.names, mask(series.x), mask(series.y))
        return marks.Placed(x, self.down(series.y), edges[0], edges[1], titles)

    def down(self, values: Array) -> Array:
        """Pixels from the top for data values (n,); what a log axis cannot show is a gap."""
        return self.top + self.height * (1 - np.clip(self.y.fraction(values), 0, 1))

    def _edge(self, values: Array) -> Array:
        """As `down`; an edge that is not positive lies at the foot of a log axis."""
        return self.down(np.maximum(values, 10.0**self.y.low) if self.y.log else values)


def render_svg(plot: Plot, width: int = WIDTH, height: int = HEIGHT) -> Markup:
    """One plot as an `<svg>` element that scales to its container.

    `height` includes legend and labels; a plot with equal scales takes the height that it needs.
    """
    legend, legend_height = _legend(plot, width)
    frame = _frame(plot, width, height, legend_height)
    across = frame.left + frame.width * frame.x.fraction(frame.x.ticks)
    x_label = plot.x_label if plot.bare else frame.x.full_label(plot.x_label)
    return fill(
        "plot.svg.j2",
        plot=plot,
        frame=frame,
        width=width,
        total=frame.top + frame.height + (46 if plot.x_label or frame.x.note else 26),
        font=FONT,
        palette=PALETTE,
        legend=legend,
        x_ticks=_shown(across, frame.x.labels),
        y_ticks=_shown(frame.down(frame.y.ticks), frame.y.labels),
        x_label=clip(x_label, FONT, frame.width),
        y_label=clip(frame.y.full_label(plot.y_label), FONT, frame.height + 20),
        drawn=_draw_series(plot, frame),
    )


def _shown(places: Array, labels: tuple[str, ...]) -> list[tuple[float, str]]:
    placed = zip(places.tolist(), labels, strict=True)
    return [(at, text) for at, text in placed if math.isfinite(at)]


def _frame(plot: Plot, width: int, height: int, legend_height: float) -> AxesFrame:
    top = 10.0 + legend_height
    tall = max(height - top - 46, 60.0)
    if plot.equal:  # the height at which equal scales just hold the data, within sensible bounds
        (x_low, x_high), (y_low, y_high) = plot_limits(plot)
        wanted = (width - 90.0) * ((y_high - y_low) / (x_high - x_low))
        tall = float(np.clip(wanted, 140, 1.25 * height))
    counts = (max(2, width // 80), max(2, round(tall / 42)))
    y_axis = plot_axes(plot, (width - 90.0, tall), counts)[1]
    widest = max((text_width(text, FONT) for text in y_axis.labels), default=0)
    left = min(14 + 1.1 * widest + (24 if plot.y_label or y_axis.note else 0), width / 2)
    left = 8.0 if plot.bare else left
    shape = (width - left - (8 if plot.bare else 16), tall)
    x_axis, y_axis = plot_axes(plot, shape, counts)
    return AxesFrame(left, top, *shape, x_axis, y_axis)


def assign_slots(plot: Plot) -> list[int]:
    """Colour and marker of each series: those of its role, else the first that are free."""
    taken = {_ROLES[s.label] for s in plot.series if s.label in _ROLES}
    free = (slot for slot in count() if slot not in taken)
    return [_ROLES[s.label] if s.label in _ROLES else next(free) for s in plot.series]


def _draw_series(plot: Plot, frame: AxesFrame) -> list[Group]:
    """Every series that has a point, or a piece of band, to show."""
    slots = assign_slots(plot)
    crowded = any(s.mark == "points" and len(s.x) > marks.CROWDED for s in plot.series)
    drawn: list[Group] = []
    for i, series in enumerate(plot.series):
        parts = [part for part in (series.y, series.low, series.high) if part is not None]
        x = mask(series.x)
        if not any(np.isfinite(x + mask(part, plot.log_y)).any() for part in parts):
            continue
        placed = frame.place(series)
        match series.mark:
            case "net":
                drawn.append((None, [Shape("net", one.d) for one in marks.line(placed)]))
            case "points":
                points = marks.scatter(placed, slots[i], dots=crowded)
                drawn.append((slots[i], marks.error_bars(placed) + points))
            case "rings":
                drawn.append((slots[i], marks.rings(placed)))
            case _:
                line = marks.line(placed, _dash(plot, i))
                drawn.append((slots[i], marks.band(placed) + line))
    return drawn


def _dash(plot: Plot, i: int) -> str:
    """The dash pattern of a line: the first is solid, and so is one of many points."""
    order = sum(s.mark in ("line", "band") for s in plot.series[:i])
    return DASHES[order % len(DASHES)] if len(plot.series[i].x) <= DASHED else ""


def _legend(
    plot: Plot, width: int
) -> tuple[list[tuple[int, list[Shape], float, float, str]], float]:
    """Swatches and labels in rows above the axes, and their height; none for a single series."""
    if len(plot.series) < 2:
        return [], 0.0
    x, y, drawn, slots = 4.0, 12.0, [], assign_slots(plot)
    for i, series in enumerate(plot.series):
        if series.mark == "net":
            continue
        swatch = 14.0 if series.mark in ("points", "rings") else SWATCH
        label = clip(series.label, FONT, width - SWATCH - 40)
        needed = swatch + text_width(label, FONT) + 26
        if x + needed > width and x > 4:
            x, y = 4.0, y + LEGEND_ROW
        drawn.append((slots[i], _swatch(plot, i, slots[i], x, y), x + swatch + 5, y + 4.3, label))
        x += needed
    return drawn, y + 6


def _swatch(plot: Plot, i: int, slot: int, x: float, y: float) -> list[Shape]:
    series = plot.series[i]
    match series.mark:
        case "points":
            return [Shape("mark", marks.MARKERS[slot % len(marks.MARKERS)](x + 7, y))]
        case "rings":
            return [Shape("line", marks.ring(x, y, 6))]
    line = Shape("line", f"M{short(x)},{short(y)}h{SWATCH:g}", _dash(plot, i))
    area = Shape("band", f"M{short(x)},{short(y - 5)}h{SWATCH:g}v10h-{SWATCH:g}z")
    return [line] if series.low is None else [area, line]
