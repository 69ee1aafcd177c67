"""A report on one page of a terminal: verdict and card first, then what fits; no line too wide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from io import StringIO

from rich.cells import cell_len
from rich.console import Console
from rich.text import Text as Line

from imucalib.report.document import Card, Document, Facts, Plot, Section, Table, Text, Tone
from imucalib.report.render.shortened import shortened
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
    drawn = [s.title for s in document.sections if s.blocks and not _written(s)]
    sections = [s for s in document.sections if _written(s) and (s.brief or full)]
    lines = [*_head(document, width), *_card(document.card, width)]
    if full:
        hidden = drawn
    else:
        if document.card:
            document = replace(document, footer=_command(document))
        titles = [s.title for s in document.sections]
        sections = _fitting(
            sections, PAGE - len(lines) - len(_foot(document, width, titles)), width
        )
        hidden = [title for title in titles if title not in {s.title for s in sections}]
    lines += [line for section in sections for line in _section(section, width)]
    lines += _foot(document, width, hidden, full=full or set(hidden) <= set(drawn))
    return _printed(lines, width, color)


def _written(section: Section) -> bool:
    """Whether anything of it is words."""
    return any(not isinstance(block, Plot) for block in section.blocks)


def _command(document: Document) -> tuple[tuple[str, str], ...]:
    """Of the footer what one page holds."""
    return tuple(row for row in document.footer if row[0] in ("input", "command"))


def _fitting(sections: Sequence[Section], room: int, width: int) -> list[Section]:
    """What is kept, shortened to the room, and what else fits into `room` lines; in its order."""

    def length(section: Section) -> int:
        return len(_section(section, width))

    kept = iter(shortened([s for s in sections if s.kept], room, length))
    sections = [next(kept) if section.kept else section for section in sections]
    room -= sum(length(section) for section in sections if section.kept)
    shown = []
    for section in sections:
        if section.kept:
            shown.append(section)
        elif length(section) <= room:
            shown.append(section)
            room -= length(section)
    return shown


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


def _foot(
    document: Document, width: int, hidden: Sequence[str], *, full: bool = False
) -> list[Line]:
    measure = min(width, MEASURE)
    rows = [*document.footer]
    if hidden:
        where = [] if full else ["--full shows all"]
        where += [f"{document.drawn} draws {'it' if len(hidden) == 1 else 'them'}"]
        where = where if full or document.card else where[:1]
        titles = ", ".join(map(one_line, hidden))
        rows.append(("Not shown here", f"{titles}; {', '.join(where)}"))
    if not rows:
        return []
    return [Line(), Line("─" * measure, "dim"), *_facts(rows, measure, "dim")]
