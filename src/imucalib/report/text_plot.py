"""Small plots in characters: lines in braille dots, points as one character a series.

A plot of named bars becomes horizontal bars, which need one row each and no axis.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.cells import cell_len
from rich.text import Text

from imucalib.report.axes import Axis, drawable, drawable_at_all, named_places, plot_axes
from imucalib.report.document import Array, Plot, Series
from imucalib.report.terminal import clipped, clipped_all, one_line
from imucalib.report.thinning import runs, thinned

ROWS = 12
COLUMNS = 64
GUTTER = 10
INTERVAL = 28  # cells kept for the number behind a bar
MOST_BARS = 24
MARKERS = "●○▲△■□◆◇"
COLOURS = ("cyan", "yellow", "green", "magenta", "blue", "red")
_DOT = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], dtype=np.int64)
_EIGHTHS = " ▏▎▍▌▋▊▉█"


@dataclass(frozen=True)
class _Canvas:
    """Cells (rows, columns): braille patterns, characters that cover them, and their series."""

    dots: NDArray[np.int64]
    marks: NDArray[np.str_]
    owner: NDArray[np.int64]

    @classmethod
    def blank(cls, rows: int, columns: int) -> _Canvas:
        shape = (rows, columns)
        return cls(np.zeros(shape, np.int64), np.full(shape, ""), np.full(shape, -1))

    def dot(self, x: Array, y: Array, series: int) -> None:
        """Set braille dots at fractions 0..1 of the canvas; NaN is nothing."""
        rows, columns = self.dots.shape
        good = np.isfinite(x) & np.isfinite(y)
        i = np.clip(np.floor((1 - y[good]) * rows * 4), 0, rows * 4 - 1).astype(np.int64)
        j = np.clip(np.floor(x[good] * columns * 2), 0, columns * 2 - 1).astype(np.int64)
        np.bitwise_or.at(self.dots, (i // 4, j // 2), _DOT[i % 4, j % 2])
        self.owner[i // 4, j // 2] = series

    def mark(self, x: Array, y: Array, character: str, series: int) -> None:
        """Put a character into the cells at fractions 0..1; NaN is nothing."""
        rows, columns = self.dots.shape
        good = np.isfinite(x) & np.isfinite(y)
        i = np.clip(np.floor((1 - y[good]) * rows), 0, rows - 1).astype(np.int64)
        j = np.clip(np.floor(x[good] * columns), 0, columns - 1).astype(np.int64)
        self.marks[i, j] = character
        self.owner[i, j] = series

    def lines(self, zero_row: int) -> Iterator[Text]:
        """The rows from top to bottom; a dotted line through the empty cells of `zero_row`."""
        for i, (dots, marks) in enumerate(zip(self.dots, self.marks, strict=True)):
            line, empty = Text(), "┄" if i == zero_row else " "
            for dot, mark, series in zip(dots, marks, self.owner[i], strict=True):
                character = str(mark) or (chr(0x2800 + int(dot)) if dot else empty)
                line.append(character, COLOURS[series % len(COLOURS)] if series >= 0 else "dim")
            yield line


def plot_lines(plot: Plot, width: int) -> list[Text]:
    """The rows of a plot, none wider than `width` cells (at least 30)."""
    if not any(drawable_at_all(series, plot.log_y) for series in plot.series):
        return [Text("(no values to draw)", "dim")]
    return _bar_rows(plot, width) or _axes_rows(plot, width)


def _axes_rows(plot: Plot, width: int) -> list[Text]:
    across = min(COLUMNS, width - GUTTER - 3)
    x_axis, y_axis = plot_axes(plot, (2 * across, 4 * ROWS), (max(2, across // 11), 4))
    canvas = _Canvas.blank(ROWS, across)
    for i, series in enumerate(plot.series):
        _draw(canvas, plot, i, x_axis.fraction(series.x), y_axis)
    labels = _by_place(y_axis, ROWS, down=True)
    gutter = min(max(cell_len(label) for label in (*labels.values(), "")), GUTTER)
    zero = next((row for row, label in labels.items() if label == "0"), -1)
    rows = _heading(plot, y_axis, width)
    for i, line in enumerate(canvas.lines(zero)):
        label = clipped(labels.get(i, ""), gutter)
        edge = "┤" if label else "│"
        rows.append(Text(f"{label:>{gutter}} {edge}", "dim") + line)
    return rows + [Text(" " * (gutter + 1) + row, "dim") for row in _x_rows(plot, x_axis, across)]


def _heading(plot: Plot, y_axis: Axis, width: int) -> list[Text]:
    """The y label, then a legend with the range of every series, in rows."""
    pieces = [Text(y_axis.titled(one_line(plot.y_label)), "dim")]
    for i, series in enumerate(plot.series):
        shown = drawable(series.y)
        if len(plot.series) < 2 or np.isnan(shown).all():
            continue
        span = f"({np.nanmin(shown):.3g} to {np.nanmax(shown):.3g})"
        alone = series.mark not in ("points", "bars") and _curves(plot) == 1
        label = f"{'─' if alone else _marker(i)} {one_line(series.label)} {span}"
        pieces.append(Text(label, COLOURS[i % len(COLOURS)]))
    rows: list[Text] = []
    for piece in pieces:
        piece.truncate(width, overflow="ellipsis")
        if rows and rows[-1].cell_len + 3 + piece.cell_len <= width:
            rows[-1] = rows[-1] + Text("   ") + piece
        elif piece:
            rows.append(piece)
    return rows


def _marker(i: int) -> str:
    return MARKERS[i % len(MARKERS)]


def _curves(plot: Plot) -> int:
    return sum(s.mark not in ("points", "bars") for s in plot.series)


def _by_place(axis: Axis, cells: int, *, down: bool = False) -> dict[int, str]:
    """Cell -> tick label."""
    at = axis.fraction(axis.ticks)
    placed = ((1 - f if down else f, label) for f, label in zip(at, axis.labels, strict=True))
    return {min(int(f * cells), cells - 1): label for f, label in placed if 0 <= f <= 1}


def _x_rows(plot: Plot, axis: Axis, across: int) -> list[str]:
    """The axis, its tick labels where they do not touch, and the x label."""
    labels = _by_place(axis, across)
    line = "".join("┬" if i in labels else "─" for i in range(across))
    text = ""
    for place, label in sorted(labels.items()):
        start = max(place - len(label) // 2, 0)
        if start + len(label) <= across and (start > len(text) or not text):
            text = text.ljust(start) + label
    title = clipped(axis.titled(one_line(plot.x_label)), across)
    spare = " " * ((across - cell_len(title)) // 2)
    return [f"└{line}", f" {text}", *([f" {spare}{title}"] if title else [])]


def _draw(canvas: _Canvas, plot: Plot, i: int, x: Array, axis: Axis) -> None:
    series, y = plot.series[i], axis.fraction(plot.series[i].y)
    low, high = (None if e is None else axis.fraction(e) for e in (series.low, series.high))
    isolated = series.mark in ("points", "bars")
    if series.mark == "bars":
        foot = np.zeros(1) if axis.log else axis.fraction(np.zeros(1))
        canvas.dot(*_strokes(x, np.repeat(foot, len(y)), y), i)
    if low is not None and high is not None:
        if isolated:
            canvas.dot(*_strokes(x, low, high), i)
        else:
            _curve(canvas, x, low, i, sparse=True)
            _curve(canvas, x, high, i, sparse=True)
    if isolated:
        canvas.mark(x, y, _marker(i), i)
        return
    if series.mark == "step" and len(x):
        x, y = np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]
    _curve(canvas, x, y, i)
    if _curves(plot) > 1:
        _sign(canvas, x, y, i)


def _curve(canvas: _Canvas, x: Array, y: Array, series: int, *, sparse: bool = False) -> None:
    """Straight lines between neighbours, dotted where `sparse`; a gap breaks the line."""
    columns = canvas.dots.shape[1]
    share = np.linspace(0, 1, 2 * columns)
    for run in runs(thinned(x, y), ~(np.isfinite(x) & np.isfinite(y))):
        px, py = x[run], y[run]
        if len(run) > 1:
            px, py = ((v[:-1, None] + np.diff(v)[:, None] * share).ravel() for v in (px, py))
        keep = np.floor(px * columns * 2) % 3 == 0 if sparse else np.full(len(px), True)
        canvas.dot(px[keep], py[keep], series)


def _strokes(x: Array, start: Array, stop: Array) -> tuple[Array, Array]:
    """Vertical lines as dots."""
    keep = thinned(x, start + stop)
    x, start, stop = x[keep], start[keep], stop[keep]
    share = np.linspace(0, 1, 4 * ROWS)
    y = start[:, None] + (stop - start)[:, None] * share
    return np.repeat(x, len(share)), y.ravel()


def _sign(canvas: _Canvas, x: Array, y: Array, i: int) -> None:
    """The marker of the series at a few places of its curve, elsewhere than other series'."""
    good = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if good.size:
        wanted = (np.arange(5) + (i % 4 + 1) / 5) / 5
        nearest = good[np.argmin(np.abs(x[good, None] - wanted), axis=0)]
        canvas.mark(x[nearest], y[nearest], _marker(i), i)


def _bar_rows(plot: Plot, width: int) -> list[Text]:
    """Named bars as horizontal bars, a row each; empty where the plot is of another kind."""
    places = named_places(plot)
    values = [drawable(s.y) for s in plot.series]
    if (
        plot.log_y
        or not places
        or any(s.mark != "bars" for s in plot.series)
        or sum(v.size for v in values) > MOST_BARS
        or min(np.nanmin(v, initial=0.0) for v in values) < 0
    ):
        return []
    largest = max(float(np.nanmax(v, initial=0.0)) for v in values) or 1.0
    names = clipped_all(places.values(), width // 4)
    labels = clipped_all((s.label for s in plot.series), width // 4)
    room = max(min(40, width - cell_len(names[0]) - cell_len(labels[0]) - INTERVAL), 4)
    rows = [Text(clipped(one_line(plot.y_label), width), "dim")] if plot.y_label else []
    for x, name in sorted(zip(places, names, strict=True)):
        lead = name
        for i, series in enumerate(plot.series):
            for k in np.flatnonzero(series.x == x):
                bar = _bar(float(values[i][k]) / largest * room)
                row = Text(f"{lead} ") + Text(f"{labels[i]} {bar}", COLOURS[i % len(COLOURS)])
                rows.append(row + Text(_reading(series, int(k))))
                lead = " " * cell_len(name)
    for row in rows:
        row.truncate(width, overflow="ellipsis")
    return rows


def _reading(series: Series, k: int) -> str:
    """The number at the end of a bar, with its interval."""
    if not np.isfinite(series.y[k]):
        return " —"
    text = f" {series.y[k]:.3g}"
    if series.low is None or series.high is None:
        return text
    return f"{text} ({series.low[k]:.3g} to {series.high[k]:.3g})"


def _bar(length: float) -> str:
    """A horizontal bar of so many cells, an eighth fine."""
    if np.isnan(length):
        return ""
    eighths = round(length * 8)
    return "█" * (eighths // 8) + _EIGHTHS[eighths % 8].strip()
