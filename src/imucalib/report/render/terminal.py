"""Text made safe for a terminal, and how tones look there."""

from __future__ import annotations

import unicodedata
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from imucalib.report.render.document import Tone

#: A tone without and with colours.
SIGNS: dict[Tone, str] = {"ok": "✓", "warning": "!", "bad": "✗", "plain": ""}
STYLES: dict[Tone, str] = {"ok": "green", "warning": "yellow", "bad": "red", "plain": ""}


def one_line(text: str) -> str:
    """The text without line breaks, tabs, or controls that could steer the terminal."""
    return " ".join(safe(text).split())


def safe(text: str) -> str:
    """The text with line breaks kept, tabs as spaces, controls and the like replaced by "?".

    A field of a foreign file must not move the cursor, hide text or change its direction.
    """
    spaced = text.replace("\r\n", "\n").replace("\t", " ").replace("\u2028", "\n")
    return "".join(c if c == "\n" or unicodedata.category(c)[0] != "C" else "?" for c in spaced)
