"""Looks of the marks: colours of the series, dashes, and the attributes of each kind of shape."""

from __future__ import annotations

from imucalib.report.document import Plot

PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "currentColor")
FONT = 12.5
DASHED = 200  # points of a line that may be dashed: a longer one is too ragged for it
DASHES = ("", "7 3", "2 3", "8 3 2 3", "12 4", "4 2 1 2 1 2")

# Presentation attributes, not a style sheet: any CSS of the page wins over them.
_SHAPES = {
    "line": 'fill="none" stroke="currentColor" stroke-width="1.6" stroke-linejoin="round"'
    ' stroke-linecap="round"',
    "net": 'fill="none" stroke="currentColor" stroke-opacity="0.3"',
    "band": 'fill="currentColor" fill-opacity="0.2"',
    "whisker": 'fill="none" stroke="currentColor" stroke-width="1.2"',
    "stem": 'fill="none" stroke="currentColor" stroke-width="1.2"',
    "mark": 'fill="currentColor"',
    "bar": 'fill="currentColor" fill-opacity="0.85"',
    "dots": 'fill="none" stroke="currentColor" stroke-width="2.6" stroke-linecap="round"',
}


def dash_of(plot: Plot, i: int) -> str:
    """The dash pattern of a line: the first is solid, and so is one of many points."""
    order = sum(s.mark in ("line", "band", "step") for s in plot.series[:i])
    return DASHES[order % len(DASHES)] if len(plot.series[i].x) <= DASHED else ""


def coloured(i: int, body: str) -> str:
    """Shapes in the colour of series `i`, which a page may set by a CSS variable."""
    n = i % len(PALETTE)
    return f'<g style="color:var(--series-{n},{PALETTE[n]})">{shaped(body)}</g>'


def shaped(body: str) -> str:
    """Shape names replaced by their presentation attributes."""
    for name, attributes in _SHAPES.items():
        body = body.replace(f'class="{name}"', attributes)
    return body
