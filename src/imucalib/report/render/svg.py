"""A plot as SVG: own drawing, small, without scripts or fonts, for light and dark backgrounds.

Text and axes use `currentColor`; series take the CSS variables `--series-0` ... `--series-6`, with
the palette of Okabe and Ito (colour universal design, 2008) as fallback.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.report.document import Plot, Series
from imucalib.report.render import marks
from imucalib.report.render.axes import (
    Axis,
    bar_slot,
    drawable,
    drawable_at_all,
    named_places,
    plot_axes,
    plot_limits,
)
from imucalib.report.render.markup import clipped, escape, short, text_width
from imucalib.report.render.svg_style import FONT, coloured, dash_of, shaped

WIDTH, HEIGHT = 500, 300
LEGEND_ROW = 20.0
SWATCH = 26.0


@dataclass(frozen=True)
class Frame:
    """The rectangle of the axes in pixels, and the axes that it carries."""

    left: float
    top: float
    width: float
    height: float
    x: Axis
    y: Axis

    def place(self, series: Series, shift: float = 0.0) -> marks.Placed:
        """A series in pixels; `shift` moves it sideways (bars side by side)."""
        x = self.left + shift + self.width * self.x.fraction(series.x)
        edges = [None if e is None else self._edge(e) for e in (series.low, series.high)]
        titles = marks.hover(series.names, drawable(series.x), drawable(series.y))
        return marks.Placed(x, self.down(series.y), edges[0], edges[1], titles)

    def down(self, values: Array) -> Array:
        """Pixels from the top for data values (n,); what a log axis cannot show is a gap."""
        return self.top + self.height * (1 - np.clip(self.y.fraction(values), 0, 1))

    def _edge(self, values: Array) -> Array:
        """As `down`; an edge that is not positive lies at the foot of a log axis."""
        return self.down(np.maximum(values, 10.0**self.y.low) if self.y.log else values)


def render_svg(plot: Plot, width: int = WIDTH, height: int = HEIGHT) -> str:
    """One plot as an `<svg>` element that scales to its container.

    `height` includes legend and labels; a plot with equal scales takes the height that it needs.
    """
    legend, legend_height = _legend(plot, width)
    frame = _frame(plot, width, height, legend_height)
    total = frame.top + frame.height + (46 if plot.x_label or frame.x.note else 26)
    label = escape(f"{plot.title}. {plot.caption}".strip(". "))
    axes = _x_label(plot, frame, 18.0) if plot.bare else _grid(frame) + _x_axis(plot, frame)
    body = "".join([legend, axes, _series(plot, frame)])
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" class="plot" role="img" aria-label="{label}"'
        f' viewBox="0 0 {width} {short(total)}" width="{width}" height="{short(total)}"'
        f' font-size="{FONT}" font-family="system-ui, sans-serif" fill="currentColor">'
        f"{body}{_y_label(plot, frame)}</svg>"
    )


def _frame(plot: Plot, width: int, height: int, legend_height: float) -> Frame:
    top = 10.0 + legend_height
    tall = max(height - top - 46, 60.0)
    if plot.equal:
        tall = _equal_height(plot, width - 90.0, 1.25 * height)
    counts = (max(2, width // 80), max(2, round(tall / 42)))
    y_axis = plot_axes(plot, (width - 90.0, tall), counts)[1]
    widest = max((text_width(text, FONT) for text in y_axis.labels), default=0)
    left = min(14 + 1.1 * widest + (24 if plot.y_label or y_axis.note else 0), width / 2)
    left = 8.0 if plot.bare else left
    shape = (width - left - (8 if plot.bare else 16), tall)
    x_axis, y_axis = plot_axes(plot, shape, counts)
    return Frame(left, top, *shape, _categories(plot, x_axis, shape[0]), y_axis)


def _equal_height(plot: Plot, width: float, tallest: float) -> float:
    """Height at which equal scales just hold the data, within sensible bounds."""
    x, y = plot_limits(plot)
    return float(np.clip(width * ((y[1] - y[0]) / (x[1] - x[0])), 140, tallest))


def _categories(plot: Plot, axis: Axis, width: float) -> Axis:
    """Names under the bars instead of numbers, where all are named and have room."""
    places = named_places(plot) if any(s.mark == "bars" for s in plot.series) else {}
    room = width * bar_slot(plot) / (axis.high - axis.low) - 4
    if not places or any(text_width(name, FONT) > room for name in places.values()):
        return axis
    return Axis(axis.low, axis.high, np.array(list(places)), tuple(places.values()))


def _grid(frame: Frame) -> str:
    """Light grid lines, the y tick labels, and a stronger line at zero."""
    rows, right = [], frame.left + frame.width
    for y, label in _ticks(frame.y, lambda t: float(frame.down(np.array([t]))[0])):
        zero = label == "0" and not frame.y.log
        rows.append(
            f'<path d="M{short(frame.left)},{short(y)}H{short(right)}" stroke="currentColor"'
            f' stroke-opacity="{0.45 if zero else 0.13}"/><text x="{short(frame.left - 7)}"'
            f' y="{short(y + 4.3)}" text-anchor="end">{escape(label)}</text>'
        )
    return f'<g class="grid">{"".join(rows)}</g>'


def _ticks(axis: Axis, place: Callable[[float], float]) -> list[tuple[float, str]]:
    placed = [(place(float(t)), text) for t, text in zip(axis.ticks, axis.labels, strict=True)]
    return [(at, text) for at, text in placed if np.isfinite(at)]


def _x_axis(plot: Plot, frame: Frame) -> str:
    bottom = frame.top + frame.height
    parts = [
        f'<path d="M{short(frame.left)},{short(bottom)}h{short(frame.width)}"'
        ' stroke="currentColor" stroke-opacity="0.7"/>'
    ]

    def across(tick: float) -> float:
        return frame.left + frame.width * float(frame.x.fraction(np.array([tick]))[0])

    barred = any(series.mark == "bars" for series in plot.series)
    for x, label in _ticks(frame.x, across):
        if not barred:
            parts.append(
                f'<path d="M{short(x)},{short(frame.top)}V{short(bottom)}" stroke="currentColor"'
                ' stroke-opacity="0.08"/>'
            )
        parts.append(
            f'<path d="M{short(x)},{short(bottom)}v4" stroke="currentColor" stroke-opacity="0.7"/>'
            f'<text x="{short(x)}" y="{short(bottom + 18)}" text-anchor="middle">'
            f"{escape(label)}</text>"
        )
    return f'<g class="x">{"".join(parts)}{_x_label(plot, frame, 39.0)}</g>'


def _x_label(plot: Plot, frame: Frame, below: float) -> str:
    """The label, `below` pixels under the axes."""
    label = clipped(plot.x_label if plot.bare else frame.x.titled(plot.x_label), FONT, frame.width)
    if not label:
        return ""
    x, y = short(frame.left + frame.width / 2), short(frame.top + frame.height + below)
    return f'<text class="axis" x="{x}" y="{y}" text-anchor="middle">{escape(label)}</text>'


def _y_label(plot: Plot, frame: Frame) -> str:
    label = clipped(frame.y.titled(plot.y_label), FONT, frame.height + 20)
    if not label:
        return ""
    middle = frame.top + frame.height / 2
    return (
        f'<text class="axis" transform="translate(14,{short(middle)}) rotate(-90)"'
        f' text-anchor="middle">{escape(label)}</text>'
    )


def _series(plot: Plot, frame: Frame) -> str:
    grouped = [i for i, s in enumerate(plot.series) if s.mark == "bars"]
    slot = frame.width * bar_slot(plot) / (frame.x.high - frame.x.low) * 0.76
    wide = min(slot / max(len(grouped), 1), 64.0)
    foot = frame.top + frame.height
    if not plot.log_y:
        foot = float(frame.down(np.zeros(1))[0])
    drawn: list[str] = []
    for i, series in enumerate(plot.series):
        shift = (grouped.index(i) - (len(grouped) - 1) / 2) * wide if i in grouped else 0.0
        placed = frame.place(series, shift)
        if not drawable_at_all(series, plot.log_y):
            continue
        if series.mark == "net":
            faint = marks.line(placed).replace('class="line"', 'class="net"')
            drawn.append(shaped(faint))
            continue
        drawn.append(coloured(i, _mark(plot, i, placed, foot, wide * 0.92)))
        if i in grouped:  # in the colour of the text: a bar hides whiskers of its own colour
            whiskers = marks.error_bars(placed, min(4.0, wide / 3))
            drawn.append(shaped(whiskers))
    return "".join(drawn) or _nothing(frame)


def _nothing(frame: Frame) -> str:
    x, y = frame.left + frame.width / 2, frame.top + frame.height / 2
    return f'<text x="{short(x)}" y="{short(y)}" text-anchor="middle">no values to draw</text>'


def _mark(plot: Plot, i: int, placed: marks.Placed, foot: float, wide: float) -> str:
    series = plot.series[i]
    if series.mark == "points":
        return marks.error_bars(placed) + marks.scatter(placed, i, dots=_crowded(plot))
    if series.mark == "rings":
        return marks.rings(placed)
    if series.mark == "bars":
        return marks.bars(placed, foot, wide)
    return marks.band(placed) + marks.line(placed, dash_of(plot, i), series.mark == "step")


def _crowded(plot: Plot) -> bool:
    """Whether its points are dots: all of a plot, or none."""
    return any(s.mark == "points" and len(s.x) > marks.CROWDED for s in plot.series)


def _legend(plot: Plot, width: int) -> tuple[str, float]:
    """Swatches and labels in rows above the axes; nothing for a single series."""
    if len(plot.series) < 2:
        return "", 0.0
    x, y, drawn = 4.0, 12.0, []
    for i, series in enumerate(plot.series):
        if series.mark == "net":
            continue
        swatch = 14.0 if series.mark in ("points", "bars", "rings") else SWATCH
        label = clipped(series.label, FONT, width - SWATCH - 40)
        needed = swatch + text_width(label, FONT) + 26
        if x + needed > width and x > 4:
            x, y = 4.0, y + LEGEND_ROW
        text = f'<text x="{short(x + swatch + 5)}" y="{short(y + 4.3)}">{escape(label)}</text>'
        drawn.append(coloured(i, _swatch(plot, i, x, y)) + text)
        x += needed
    return f'<g class="legend">{"".join(drawn)}</g>', y + 6


def _swatch(plot: Plot, i: int, x: float, y: float) -> str:
    series, dash = plot.series[i], dash_of(plot, i)
    if series.mark == "points":
        return f'<path class="mark" d="{marks.MARKERS[i % len(marks.MARKERS)](x + 7, y)}"/>'
    if series.mark == "rings":
        return f'<path class="line" d="M{short(x)},{short(y)}a6,6 0 1,0 12,0a6,6 0 1,0 -12,0"/>'
    if series.mark == "bars":
        return f'<rect class="bar" x="{short(x)}" y="{short(y - 5)}" width="14" height="10"/>'
    area = f'<path class="band" d="M{short(x)},{short(y - 5)}h{SWATCH:g}v10h-{SWATCH:g}z"/>'
    stroke = f' stroke-dasharray="{dash}"' if dash else ""
    line = f'<path class="line" d="M{short(x)},{short(y)}h{SWATCH:g}"{stroke}/>'
    return line if series.low is None else area + line
