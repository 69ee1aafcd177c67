"""Text made safe for XML and HTML, and lengths written short."""

from __future__ import annotations

import re
import unicodedata
from html import escape as escape_entities

import numpy as np

from imucalib.arrays import Array

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
