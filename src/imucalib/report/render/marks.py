"""Marks of one series as outlines in pixels; long series thinned without losing an extreme."""

from __future__ import annotations

import unicodedata
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.report.render.templates import short

LONGEST = 2000  # points drawn one by one; beyond, extremes of buckets
NAMED = 600  # points that carry a hover title
CROWDED = 300  # points that are drawn as dots
MARKERS: tuple[Callable[[float, float], str], ...] = (
    lambda x, y: f"M{short(x - 3)},{short(y)}a3,3 0 1,0 6,0a3,3 0 1,0 -6,0",  # circle
    lambda x, y: f"M{short(x - 2.7)},{short(y - 2.7)}h5.4v5.4h-5.4z",  # square
    lambda x, y: f"M{short(x)},{short(y - 3.7)}l3.6,6.2h-7.2z",  # triangle
    lambda x, y: f"M{short(x)},{short(y - 3.9)}l3.9,3.9l-3.9,3.9l-3.9,-3.9z",  # diamond
    lambda x, y: f"M{short(x - 3)},{short(y - 1)}h2v-2h2v2h2v2h-2v2h-2v-2h-2z",  # plus
    lambda x, y: f"M{short(x)},{short(y + 3.7)}l3.6,-6.2h-7.2z",  # triangle down
)


@dataclass(frozen=True)
class Shape:
    """One path; `kind` says how it looks."""

    kind: str
    d: str
    dash: str = ""
    title: str = ""


@dataclass(frozen=True)
class Placed:
    """One series in pixels (y down); NaN is a gap. `titles` is empty or one a point."""

    x: Array
    y: Array
    low: Array | None
    high: Array | None
    titles: tuple[str, ...]


def thin(x: Array, y: Array) -> Index:
    """Indices, ascending, of the points to draw: all, or first, last and bucket extremes of x, y.

    The number kept is bounded by about two times `LONGEST`; gaps are not among them.
    """
    good = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if good.size <= LONGEST:
        return good
    buckets = LONGEST // 2
    size = -(-good.size // buckets)
    rows = np.concatenate([good, np.full(-good.size % size, good[-1])]).reshape(-1, size)
    extremes = [pick(values[rows], axis=1) for values in (x, y) for pick in (np.argmin, np.argmax)]
    ends = [good[:1], good[-1:]]
    return np.unique(np.concatenate([rows[np.arange(len(rows)), c] for c in extremes] + ends))


def _runs(keep: Index, broken: Flags) -> list[Index]:
    """The kept indices split where a gap (`broken`, bool (n,)) lies between two neighbours."""
    if keep.size == 0:
        return []
    gaps = np.cumsum(broken)
    return np.split(keep, np.flatnonzero(np.diff(gaps[keep])) + 1)


def _pairs(x: Array, y: Array) -> list[str]:
    """Coordinate pairs "x,y", a tenth of a unit fine."""
    tenths = np.round(np.stack([x, y], axis=1), 1).tolist()
    return [f"{a:g},{b:g}" for a, b in tenths]


def text_width(text: str, size: float) -> float:
    """Estimated width of `text` in a sans-serif font of `size`; wide scripts count double."""
    cells = sum(1.0 if unicodedata.east_asian_width(c) in "WF" else 0.57 for c in text)
    return cells * size


def clip(text: str, size: float, room: float) -> str:
    """The text, cut with an ellipsis where its estimated width exceeds `room`."""
    if text_width(text, size) <= room:
        return text
    while text and text_width(text + "…", size) > room:
        text = text[:-1]
    return text + "…"


def ring(x: float, y: float, radius: float) -> str:
    """The path of a circle that starts at its left end, `x`."""
    turn = f"a{radius:g},{radius:g} 0 1,0"
    return f"M{short(x)},{short(y)}{turn} {2 * radius:g},0{turn} -{2 * radius:g},0"


def line(placed: Placed, dash: str = "") -> list[Shape]:
    """A polyline broken at gaps; a lone point between gaps is a dot."""
    x, y = placed.x, placed.y
    pieces = []
    for run in _runs(thin(x, y), ~(np.isfinite(x) & np.isfinite(y))):
        pairs = _pairs(x[run], y[run])
        pieces.append("M" + "L".join(pairs) if len(run) > 1 else f"M{pairs[0]}h0")
    return _draw("line", pieces, dash)


def band(placed: Placed) -> list[Shape]:
    """The area between `low` and `high`, broken at gaps."""
    if placed.low is None or placed.high is None:
        return []
    lower, upper = np.maximum(placed.low, placed.high), np.minimum(placed.low, placed.high)
    broken = ~(np.isfinite(placed.x) & np.isfinite(lower) & np.isfinite(upper))
    pieces = []
    for run in _runs(np.flatnonzero(~broken), broken):
        top, bottom = thin(placed.x[run], upper[run]), thin(placed.x[run], lower[run])
        forth = _pairs(placed.x[run][top], upper[run][top])
        back = _pairs(placed.x[run][bottom], lower[run][bottom])[::-1]
        pieces.append("M" + "L".join(forth + back) + "z")
    return _draw("band", pieces)


def error_bars(placed: Placed, cap: float = 3.0) -> list[Shape]:
    """Vertical bars from `low` to `high` with caps."""
    if placed.low is None or placed.high is None:
        return []
    keep = thin(placed.x, (placed.low + placed.high) / 2)
    rows = zip(placed.x[keep], placed.low[keep], placed.high[keep], strict=True)
    pieces = [
        f"M{short(x - cap)},{short(a)}h{short(2 * cap)}M{short(x)},{short(a)}V{short(b)}"
        f"M{short(x - cap)},{short(b)}h{short(2 * cap)}"
        for x, a, b in rows
    ]
    return _draw("whisker", pieces)


def scatter(placed: Placed, marker: int, *, dots: bool = False) -> list[Shape]:
    """Markers; few points are separate shapes with a hover title, very many are dots."""
    keep = thin(placed.x, placed.y)
    if dots or keep.size > CROWDED:
        good = np.flatnonzero(np.isfinite(placed.x) & np.isfinite(placed.y))
        # One point for each occupied cell of a grid about as fine as a dot is wide.
        cells = np.round(np.stack([placed.x[good], placed.y[good]]) / 2).astype(np.int64)
        _, first = np.unique(cells[0] * 100_000 + cells[1], return_index=True)
        keep = good[np.sort(first)]
        return _draw("dots", [f"M{p}h0" for p in _pairs(placed.x[keep], placed.y[keep])])
    draw = MARKERS[marker % len(MARKERS)]
    shapes = [draw(float(placed.x[i]), float(placed.y[i])) for i in keep]
    if placed.titles and keep.size <= NAMED:
        rows = zip(keep, shapes, strict=True)
        return [Shape("mark", d, title=placed.titles[i]) for i, d in rows]
    return _draw("mark", shapes)


def rings(placed: Placed) -> list[Shape]:
    """Open circles around points that a reader must not miss."""
    keep = thin(placed.x, placed.y)
    ends = zip(placed.x[keep].tolist(), placed.y[keep].tolist(), strict=True)
    return _draw("line", [ring(x - 7, y, 7) for x, y in ends])


def _draw(kind: str, pieces: Sequence[str], dash: str = "") -> list[Shape]:
    """All pieces as one path, or nothing."""
    return [Shape(kind, "".join(pieces), dash)] if pieces else []


def hover_titles(names: Sequence[str], x: Array, y: Array) -> tuple[str, ...]:
    """Hover titles "name: x, y"; none for a series too long to be read point by point."""
    if len(y) > NAMED:
        return ()
    given = list(names) + [""] * (len(y) - len(names))
    rows = zip(given, x.tolist(), y.tolist(), strict=False)
    return tuple(f"{name}: {b:.6g}" if name else f"{a:.6g}, {b:.6g}" for name, a, b in rows)
