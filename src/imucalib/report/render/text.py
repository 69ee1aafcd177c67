"""A report on one page of a terminal: verdict and card first, then what fits; no line too wide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from io import StringIO

from rich.cells import cell_len
from rich.console import Console
from rich.text import Text as Line

from imucalib.report.document import Card, Document, Facts, Plot, Section, Table, Text, Tone
from imucalib.report.render.terminal import clipped, one_line, safe, wrapped
from imucalib.report.render.text_table import table_lines

NARROWEST = 40
MEASURE = 100  # longest line of running text
PAGE = 60  # lines of a report
SIGNS: dict[Tone, str] = {"ok": "✓", "warning": "!", "bad": "✗", "plain": ""}
STYLES: dict[Tone, str] = {"ok": "green", "warning": "yellow", "bad": "red", "plain": ""}
WORDS: dict[Tone, str] = {"ok": "PASSED", "warning": "CAUTION", "bad": "FAILED", "plain": ""}


def render_text(document: Document, width: int, *, color: bool, full: bool = False) -> str:
    """The brief sections without their plots; no line is wider than `width` cells (at least 40).

    One page: head, card, and of the brief sections those that fit.
    color : ANSI colours; without them every tone still shows as a sign and a word
    full : every section, however long, without its plots
    """
    width, document = max(width, NARROWEST), document.calm()
    lines = [*_head(document, width), *_card(document.card, width)]
    sections = [(s, _section(s, width)) for s in document.sections if s.brief or full]
    hidden = [s.title for s in document.sections if not (s.brief or full)]
    if full:
        shown = [rows for _, rows in sections]
    else:
        if document.card:
            document = replace(document, footer=_command(document))
        room = PAGE - len(lines) - len(_foot(document, width, [s.title for s in document.sections]))
        shown, left = _fitting(sections, room)
        hidden = [s.title for s in document.sections if s.title in {*left, *hidden}]
    lines += [line for rows in shown for line in rows]
    lines += _foot(document, width, hidden)
    return _printed(lines, width, color)


def _command(document: Document) -> tuple[tuple[str, str], ...]:
    """Of the footer what one page holds."""
    return tuple(row for row in document.footer if row[0] in ("input", "command"))


def _fitting(
    sections: Sequence[tuple[Section, list[Line]]], room: int
) -> tuple[list[list[Line]], list[str]]:
    """What is kept or fits into `room` lines, in its order, and the titles of the others."""
    room -= sum(len(rows) for section, rows in sections if section.kept)
    shown, left = [], []
    for section, rows in sections:
        if section.kept:
            shown.append(rows)
        elif len(rows) <= room:
            shown.append(rows)
            room -= len(rows)
        else:
            left.append(section.title)
    return shown, left


def _card(card: Card | None, width: int) -> list[Line]:
    """Worth, findings and steps, each with its heading."""
    if card is None:
        return []
    measure = min(width, MEASURE)
    worth = tuple((w.quantity, f"{w.value} ({w.detail})") for w in card.good_to)
    lines = [*_heading("Good to", measure), *_facts(worth, measure)]
    lines += _heading("Found", measure)
    lines += [line for text in card.found for line in _paragraph(text, measure)]
    lines += _heading("What to do", measure)
    for i, step in enumerate(card.to_do, start=1):
        rows = wrapped(safe(step), measure - 3)
        lines += [Line(f"{i}. {row}" if not k else f"   {row}") for k, row in enumerate(rows)]
    return lines


def _heading(title: str, measure: int) -> list[Line]:
    rule = "─" * (measure - cell_len(title) - 1)
    return [Line(), Line.assemble((title, "bold"), " ", (rule, "dim"))]


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
    lines = _heading(clipped(one_line(section.title), measure - 4), measure)
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


def _foot(document: Document, width: int, hidden: Sequence[str]) -> list[Line]:
    measure = min(width, MEASURE)
    rows = [*document.footer]
    if hidden:
        rows.append(("Not shown here", ", ".join(map(one_line, hidden))))
        drawn = ", report.html draws them" if document.card else ""
        rows[-1] = (rows[-1][0], f"{rows[-1][1]}; --full shows all{drawn}")
    if not rows:
        return []
    return [Line(), Line("─" * measure, "dim"), *_facts(rows, measure, "dim")]
