"""A report as one HTML file: no script, no network, plots inside, readable on paper too."""

from __future__ import annotations

from collections import Counter

from imucalib.report.render.document import Document, Tone
from imucalib.report.render.svg import render_svg
from imucalib.report.render.table import column_pads
from imucalib.report.render.templates import fill

SIGNS: dict[Tone, str] = {"ok": "✓", "warning": "⚠\ufe0e", "bad": "✗", "plain": ""}
WORDS: dict[Tone, str] = {"ok": "Passed", "warning": "Caution", "bad": "Failed", "plain": "Result"}


def render_html(document: Document) -> str:
    """The whole report, sections of every detail, as one self-contained HTML page."""
    last: Counter[str] = Counter()

    def number(kind: str) -> str:
        """Running numbers of tables and figures through the whole document."""
        last[kind] += 1
        return f"{kind} {last[kind]}"

    return fill(
        "page.html.j2",
        document=document.soften_tones(),
        number=number,
        signs=SIGNS,
        words=WORDS,
        svg=render_svg,
        column_pads=column_pads,
    )
