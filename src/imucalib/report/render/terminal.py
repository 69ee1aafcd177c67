"""Text made safe for a terminal, and measured in its cells."""

from __future__ import annotations

import unicodedata

from rich.cells import cell_len, set_cell_size


def one_line(text: str) -> str:
    """The text without line breaks, tabs, or controls that could steer the terminal."""
    return " ".join(safe(text).split())


def safe(text: str) -> str:
    """The text with line breaks kept, tabs as spaces, controls and the like replaced by "?".

    A field of a foreign file must not move the cursor, hide text or change its direction.
    """
    kept = (c if c == "\n" or unicodedata.category(c)[0] != "C" else "?" for c in _spaced(text))
    return "".join(kept)


def _spaced(text: str) -> str:
    return text.replace("\r\n", "\n").replace("\t", " ").replace("\u2028", "\n")


def clipped(text: str, width: int) -> str:
    """The text, cut with an ellipsis where it is wider than `width` cells."""
    if cell_len(text) <= width:
        return text
    return set_cell_size(text, max(width - 1, 0)).rstrip() + "…" if width > 0 else ""


def wrapped(text: str, width: int) -> list[str]:
    """Rows of at most `width` cells, broken between words; no row for empty text."""
    rows: list[str] = []
    for paragraph in text.splitlines():
        row = ""
        for word in paragraph.split():
            joined = f"{row} {word}" if row else word
            if cell_len(joined) <= width:
                row = joined
                continue
            if row:
                rows.append(row)
            *full, row = _cut(word, width)
            rows += full
        if row:
            rows.append(row)
    return rows


def _cut(word: str, width: int) -> list[str]:
    """A word in pieces that fit."""
    pieces = [""]
    for character in word:
        if cell_len(pieces[-1] + character) > width:
            pieces.append("")
        pieces[-1] += character
    return pieces
