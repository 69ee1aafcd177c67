"""Marks of one series as SVG: paths in pixels, long series thinned without losing an extreme.

Everything is drawn in `currentColor`; the group around it sets the colour of the series.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape as escape_entities

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array

Indices = NDArray[np.intp]

LONGEST = 2000  # points drawn one by one; beyond, extremes of buckets


def thinned(x: Array, y: Array) -> Indices:
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


def runs(keep: Indices, broken: NDArray[np.bool_]) -> list[Indices]:
    """The kept indices split where a gap (`broken`, bool (n,)) lies between two neighbours."""
    if keep.size == 0:
        return []
    gaps = np.cumsum(broken)
    return np.split(keep, np.flatnonzero(np.diff(gaps[keep])) + 1)


# What XML 1.0 does not allow at all, not even escaped, and the controls that HTML rejects.
_FORBIDDEN = re.compile(
    "[^\t\n\x20-\x7e\xa0-\ud7ff\ue000-\ufdcf\ufdf0-\ufffd\U00010000-\U0010ffff]"
)


def escape(text: str) -> str:
    """Text for element content or a quoted attribute; characters that XML forbids become U+FFFD."""
    return escape_entities(_FORBIDDEN.sub("\ufffd", text), quote=True)


def short(value: float) -> str:
    """A coordinate to a tenth of a unit without trailing zeros."""
    text = f"{value:.1f}"
    return text[:-2] if text.endswith(".0") else text


def points(x: Array, y: Array) -> list[str]:
    """Coordinate pairs "x,y", a tenth of a unit fine."""
    tenths = np.round(np.stack([x, y], axis=1), 1).tolist()
    return [f"{a:g},{b:g}" for a, b in tenths]


def text_width(text: str, size: float) -> float:
    """Estimated width of `text` in a sans-serif font of `size`; wide scripts count double."""
    cells = sum(1.0 if unicodedata.east_asian_width(c) in "WF" else 0.57 for c in text)
    return cells * size


def clipped(text: str, size: float, room: float) -> str:
    """The text, cut with an ellipsis where its estimated width exceeds `room`."""
    if text_width(text, size) <= room:
        return text
    while text and text_width(text + "…", size) > room:
        text = text[:-1]
    return text + "…"


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
class Placed:
    """One series in pixels (y down); NaN is a gap. `titles` is empty or one a point."""

    x: Array
    y: Array
    low: Array | None
    high: Array | None
    titles: tuple[str, ...]


def line(placed: Placed, dash: str = "", step: bool = False) -> str:
    """A polyline broken at gaps; a lone point between gaps is a dot; `step` holds each value."""
    x, y = placed.x, placed.y
    pieces = []
    for run in runs(thinned(x, y), ~(np.isfinite(x) & np.isfinite(y))):
        px, py = x[run], y[run]
        if step:
            px, py = np.repeat(px, 2)[1:], np.repeat(py, 2)[:-1]
        pairs = points(px, py)
        pieces.append("M" + "L".join(pairs) if len(run) > 1 else f"M{pairs[0]}h0")
    if not pieces:
        return ""
    style = f' stroke-dasharray="{dash}"' if dash else ""
    return f'<path class="line" d="{"".join(pieces)}"{style}/>'


def band(placed: Placed) -> str:
    """The area between `low` and `high`, broken at gaps."""
    if placed.low is None or placed.high is None:
        return ""
    lower, upper = np.maximum(placed.low, placed.high), np.minimum(placed.low, placed.high)
    broken = ~(np.isfinite(placed.x) & np.isfinite(lower) & np.isfinite(upper))
    pieces = []
    for run in runs(np.flatnonzero(~broken), broken):
        top, bottom = thinned(placed.x[run], upper[run]), thinned(placed.x[run], lower[run])
        forth = points(placed.x[run][top], upper[run][top])
        back = points(placed.x[run][bottom], lower[run][bottom])[::-1]
        pieces.append("M" + "L".join(forth + back) + "z")
    return f'<path class="band" d="{"".join(pieces)}"/>' if pieces else ""


def error_bars(placed: Placed, cap: float = 3.0) -> str:
    """Vertical bars from `low` to `high` with caps."""
    if placed.low is None or placed.high is None:
        return ""
    middle = (placed.low + placed.high) / 2
    keep = thinned(placed.x, middle)
    rows = zip(placed.x[keep], placed.low[keep], placed.high[keep], strict=True)
    d = "".join(
        f"M{short(x - cap)},{short(a)}h{short(2 * cap)}M{short(x)},{short(a)}V{short(b)}"
        f"M{short(x - cap)},{short(b)}h{short(2 * cap)}"
        for x, a, b in rows
    )
    return f'<path class="whisker" d="{d}"/>' if d else ""


def scatter(placed: Placed, marker: int, *, dots: bool = False) -> str:
    """Markers; few points are separate shapes with a hover title, very many are dots."""
    keep = thinned(placed.x, placed.y)
    draw = MARKERS[marker % len(MARKERS)]
    if dots or keep.size > CROWDED:
        keep = _one_per_pixel(placed)
        d = "".join(f"M{pair}h0" for pair in points(placed.x[keep], placed.y[keep]))
        return f'<path class="dots" d="{d}"/>' if d else ""
    shapes = [draw(float(placed.x[i]), float(placed.y[i])) for i in keep]
    if placed.titles and keep.size <= NAMED:
        return "".join(
            f'<path class="mark" d="{d}">{titled(placed.titles, int(i))}</path>'
            for i, d in zip(keep, shapes, strict=True)
        )
    return f'<path class="mark" d="{"".join(shapes)}"/>' if shapes else ""


def rings(placed: Placed) -> str:
    """Open circles around points that a reader must not miss."""
    keep = thinned(placed.x, placed.y)
    ends = zip(placed.x[keep].tolist(), placed.y[keep].tolist(), strict=True)
    d = "".join(f"M{short(x - 7)},{short(y)}a7,7 0 1,0 14,0a7,7 0 1,0 -14,0" for x, y in ends)
    return f'<path class="line" d="{d}"/>' if d else ""


def _one_per_pixel(placed: Placed) -> Indices:
    """Indices of one point for each occupied cell of a grid about as fine as a dot is wide."""
    good = np.flatnonzero(np.isfinite(placed.x) & np.isfinite(placed.y))
    cells = np.round(np.stack([placed.x[good], placed.y[good]]) / 2).astype(np.int64)
    _, first = np.unique(cells[0] * 100_000 + cells[1], return_index=True)
    return good[np.sort(first)]


def bars(placed: Placed, foot: float, width: float) -> str:
    """Bars from `foot`; where they would be thinner than 2 px, stems."""
    keep = thinned(placed.x, placed.y)
    x, y = placed.x[keep], placed.y[keep]
    if width < 2 or keep.size > NAMED:
        d = "".join(f"M{short(a)},{short(foot)}V{short(b)}" for a, b in zip(x, y, strict=True))
        return f'<path class="stem" d="{d}"/>' if d else ""
    return "".join(
        f'<rect class="bar" x="{short(a - width / 2)}" y="{short(min(b, foot))}"'
        f' width="{short(width)}" height="{short(abs(b - foot))}">'
        f"{titled(placed.titles, int(i))}</rect>"
        for i, a, b in zip(keep, x, y, strict=True)
    )


def titled(titles: Sequence[str], index: int) -> str:
    """The hover title of one point, or nothing."""
    return f"<title>{escape(titles[index])}</title>" if titles else ""


def hover(names: Sequence[str], x: Array, y: Array) -> tuple[str, ...]:
    """Hover titles "name: x, y"; none for a series too long to be read point by point."""
    if len(y) > NAMED:
        return ()
    given = list(names) + [""] * (len(y) - len(names))
    rows = zip(given, x.tolist(), y.tolist(), strict=False)
    return tuple(f"{name}: {b:.6g}" if name else f"{a:.6g}, {b:.6g}" for name, a, b in rows)
