"""A report on one page of a terminal: verdict first, brief sections only, no line too wide."""

from __future__ import annotations

from collections.abc import Sequence
from io import StringIO

from rich.cells import cell_len
from rich.console import Console
from rich.text import Text as Line

from imucalib.report.document import Document, Facts, Plot, Section, Table, Text, Tone
from imucalib.report.render.terminal import clipped, one_line, safe, wrapped
from imucalib.report.render.text_table import table_lines

NARROWEST = 40
MEASURE = 100  # longest line of running text
SIGNS: dict[Tone, str] = {"ok": "✓", "warning": "!", "bad": "✗", "plain": ""}
STYLES: dict[Tone, str] = {"ok": "green", "warning": "yellow", "bad": "red", "plain": ""}
WORDS: dict[Tone, str] = {"ok": "PASSED", "warning": "CAUTION", "bad": "FAILED", "plain": ""}


def render_text(document: Document, width: int, *, color: bool) -> str:
    """The brief sections without their plots; no line is wider than `width` cells (at least 40).

    color : ANSI colours; without them every tone still shows as a sign and a word
    """
    width = max(width, NARROWEST)
    lines = [*_head(document, width)]
    for section in document.sections:
        if section.brief:
            lines += _section(section, width)
    lines += _foot(document, width)
    return _printed(lines, width, color)


def _printed(lines: Sequence[Line], width: int, color: bool) -> str:
    out = StringIO()
    console = Console(
        file=out,
        width=width,
        force_terminal=color,
        color_system="standard" if color else None,
        no_color=not color,
        legacy_windows=False,
        highlight=False,
        markup=False,
        emoji=False,
        _environ={},
    )
    for line in lines:
        line.rstrip()
        console.print(line, no_wrap=True, overflow="crop", crop=True)
    return out.getvalue()


def _head(document: Document, width: int) -> list[Line]:
    measure = min(width, MEASURE)
    title = [Line(row, "bold") for row in wrapped(one_line(document.title), measure)]
    verdict = document.verdict
    mark = f"{SIGNS[verdict.tone]} {WORDS[verdict.tone]}: " if SIGNS[verdict.tone] else ""
    rows = wrapped(mark + safe(verdict.text), measure)
    shown = [Line(row) for row in rows] or [Line()]
    shown[0].stylize(f"bold {STYLES[verdict.tone]}".strip(), 0, len(mark))
    return [*title, Line("═" * measure, "dim"), *shown]


def _section(section: Section, width: int) -> list[Line]:
    measure = min(width, MEASURE)
    title = clipped(one_line(section.title), measure - 4)
    rule = "─" * (measure - cell_len(title) - 1)
    lines = [Line(), Line.assemble((title, "bold"), " ", (rule, "dim"))]
    blocks = [block for block in section.blocks if not isinstance(block, Plot)]
    for i, block in enumerate(blocks):
        if i and not (isinstance(block, Text) and isinstance(blocks[i - 1], Text)):
            lines.append(Line())
        lines += _block(block, width)
    return lines


def _block(block: Text | Facts | Table, width: int) -> list[Line]:
    match block:
        case Text():
            return _paragraph(block, min(width, MEASURE))
        case Facts():
            return _facts(block.rows, min(width, MEASURE))
        case Table():
            return table_lines(block, width)


def _paragraph(text: Text, width: int) -> list[Line]:
    sign = SIGNS[text.tone]
    indent = 2 if sign else 0
    rows = wrapped(safe(text.text), width - indent)
    lead = [sign.ljust(indent)] + [" " * indent] * (len(rows) - 1)
    return [Line(a + row, STYLES[text.tone]) for a, row in zip(lead, rows, strict=False)]


def _facts(rows: Sequence[tuple[str, str]], width: int, style: str = "") -> list[Line]:
    """Names in one column, values wrapped in the next."""
    names = [clipped(one_line(name), width // 3) for name, _ in rows]
    column = max((cell_len(name) for name in names), default=0) + 2
    lines = []
    for name, (_, value) in zip(names, rows, strict=True):
        for i, row in enumerate(wrapped(one_line(value), width - column) or [""]):
            lead = (name if i == 0 else "") + " " * (column - (cell_len(name) if i == 0 else 0))
            lines.append(Line.assemble((lead, "dim"), (row, style)))
    return lines


def _foot(document: Document, width: int) -> list[Line]:
    measure = min(width, MEASURE)
    left = [one_line(section.title) for section in document.sections if not section.brief]
    rows = [*document.footer]
    if left:
        rows.append(("Not shown here", ", ".join(left)))
    if not rows:
        return []
    return [Line(), Line("─" * measure, "dim"), *_facts(rows, measure, "dim")]
