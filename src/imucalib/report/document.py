"""A report as data: built once by a calibrator, rendered as terminal text or as one HTML file.

A block says what is shown, not how: `report.text` and `report.html` decide the looks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from imucalib.arrays import Array

Cell = str | float | int | None
Mark = Literal["line", "points", "bars", "band", "step"]
Tone = Literal["ok", "warning", "bad", "plain"]


@dataclass(frozen=True)
class Text:
    """One paragraph; `tone` colours a verdict, a warning or a failure."""

    text: str
    tone: Tone = "plain"


@dataclass(frozen=True)
class Facts:
    """Name and value pairs, in order (local g, file, number of positions, ...)."""

    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Table:
    """A table; numbers are already formatted by the builder so that digits match their sd.

    align : one character a column, "l" or "r"
    tones : row index -> tone, for rows that the reader must not miss
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    align: str
    note: str = ""
    tones: Mapping[int, Tone] = field(default_factory=dict)


@dataclass(frozen=True)
class Series:
    """One data series: x (n,), y (n,); `low` and `high` (n,) are the edges of a band or of bars."""

    label: str
    x: Array
    y: Array
    mark: Mark
    low: Array | None = None
    high: Array | None = None
    names: tuple[str, ...] = ()  # one label a point, shown on hover in HTML


@dataclass(frozen=True)
class Plot:
    """One set of axes. `caption` says what the reader should see in it."""

    title: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]
    caption: str = ""
    equal: bool = False  # one scale on both axes (board drawings, maps)
    log_y: bool = False


Block = Text | Facts | Table | Plot


@dataclass(frozen=True)
class Section:
    """A heading and its blocks. `brief` sections are also printed to the terminal."""

    title: str
    blocks: tuple[Block, ...]
    brief: bool = True


@dataclass(frozen=True)
class Document:
    """A whole report: headline, one-sentence verdict with its tone, sections, provenance."""

    title: str
    verdict: Text
    sections: tuple[Section, ...]
    footer: tuple[tuple[str, str], ...] = ()
