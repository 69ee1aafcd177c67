"""A report as one HTML file: no script, no network, plots inside, readable on paper too."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from imucalib.report.document import Block, Card, Document, Facts, Plot, Section, Table, Text, Tone
from imucalib.report.render.columns import column_pads, squared
from imucalib.report.render.html_style import STYLE
from imucalib.report.render.markup import escape
from imucalib.report.render.svg import render_svg

SIGNS: dict[Tone, str] = {"ok": "✓", "warning": "⚠\ufe0e", "bad": "✗", "plain": ""}
WORDS: dict[Tone, str] = {"ok": "Passed", "warning": "Caution", "bad": "Failed", "plain": "Result"}


@dataclass
class _Numbering:
    """Running numbers of tables and figures through the whole document."""

    last: dict[str, int] = field(default_factory=dict)

    def label(self, kind: str) -> str:
        self.last[kind] = self.last.get(kind, 0) + 1
        return f"{kind} {self.last[kind]}"


def render_html(document: Document) -> str:
    """The whole report, sections of every detail, as one self-contained HTML page."""
    document, numbering = document.calm(), _Numbering()
    sections = [_section(i, s, numbering) for i, s in enumerate(document.sections, start=1)]
    title = escape(document.title)
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en"><head><meta charset="utf-8"/>',
            '<meta name="viewport" content="width=device-width, initial-scale=1"/>',
            '<meta name="color-scheme" content="light dark"/>',
            f"<title>{title}</title><style>{STYLE}</style></head>",
            '<body><main class="sheet">',
            f'<header><p class="kicker">Calibration report</p><h1>{title}</h1>',
            f"{_verdict(document.verdict)}{_card(document.card)}</header>",
            _contents(document.sections),
            *sections,
            _terms(document.terms),
            _footer(document.footer),
            "</main></body></html>\n",
        ]
    )


def _verdict(verdict: Text) -> str:
    heading = f"{SIGNS[verdict.tone]} {WORDS[verdict.tone]}".strip()
    return (
        f'<div class="verdict {verdict.tone}" role="status"><b>{heading}</b>'
        f"{escape(verdict.text)}</div>"
    )


def _card(card: Card | None) -> str:
    """Worth as tiles, then what was found, what to do, and the command."""
    if card is None:
        return ""
    tiles = "".join(
        f"<div><dt>{escape(w.quantity)}</dt><dd><b>{escape(w.value)}</b>"
        f"<span>{escape(w.detail)}</span></dd></div>"
        for w in card.good_to
    )
    found = "".join(_paragraph(text) for text in card.found)
    steps = "".join(f"<li>{_code(step)}</li>" for step in card.to_do)
    again = ""
    if card.command:
        again = f'<h3>Run it again</h3><pre class="command">{escape(card.command)}</pre>'
    return (
        f'<div class="card"><h3>Good to</h3><dl class="tiles">{tiles}</dl>'
        f'<h3>Found</h3>{found}<h3>What to do next</h3><ol class="steps">{steps}</ol>'
        f"{again}</div>"
    )


def _code(text: str) -> str:
    """Text in which what stands between backticks is code."""
    parts = escape(text).split("`")
    return "".join(f"<code>{p}</code>" if i % 2 else p for i, p in enumerate(parts))


def _terms(terms: Sequence[tuple[str, str]]) -> str:
    if not terms:
        return ""
    return f'<section class="terms"><h2>Words of this report</h2>{_facts(terms)}</section>'


def _contents(sections: Sequence[Section]) -> str:
    if len(sections) < 2:
        return ""
    items = "".join(
        f'<li><span class="number">{i}</span><a href="#section-{i}">{escape(s.title)}</a></li>'
        for i, s in enumerate(sections, start=1)
    )
    return f'<nav aria-label="Contents"><ol>{items}</ol></nav>'


def _section(number: int, section: Section, numbering: _Numbering) -> str:
    heading = f'<h2><span class="number">{number}</span>{escape(section.title)}</h2>'
    blocks = "\n".join(_block(block, numbering) for block in section.blocks)
    return f'<section id="section-{number}">{heading}\n{blocks}</section>'


def _block(block: Block, numbering: _Numbering) -> str:
    match block:
        case Text():
            return _paragraph(block)
        case Facts():
            return _facts(block.rows)
        case Table():
            return _table(block, numbering.label("Table"))
        case Plot():
            return _figure(block, numbering.label("Figure"))


def _paragraph(text: Text) -> str:
    if text.tone == "plain":
        return f"<p>{escape(text.text)}</p>"
    tag = f'<span class="tag" title="{WORDS[text.tone]}">{SIGNS[text.tone]}</span>'
    return f'<p class="{text.tone}">{tag} {escape(text.text)}</p>'


def _facts(rows: Iterable[tuple[str, str]]) -> str:
    pairs = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in rows)
    return f'<dl class="facts">{pairs}</dl>' if pairs else ""


def _table(table: Table, label: str) -> str:
    header, rows, align = squared(table)
    sides = ["r" if side == "r" else "l" for side in align]
    pads = column_pads(table)
    head = "".join(
        f'<th class="{side}" scope="col">{escape(name)}</th>'
        for name, side in zip(header, sides, strict=True)
    )
    body = []
    for i, row in enumerate(rows):
        tone = table.tones.get(i, "plain")
        cells = [_cell(cell, sides[j], pads[j][i]) for j, cell in enumerate(row)]
        cells[0] = cells[0].replace(">", f">{_sign(tone)}", 1)
        css = "" if tone == "plain" else f' class="{tone}"'
        body.append(f"<tr{css}>{''.join(cells)}</tr>")
    note = f'<p class="note">{escape(table.note)}</p>' if table.note else ""
    title = escape(table.title)
    return (
        f'<div class="table"><p class="label"><span>{label}</span>&#8195;{title}</p>'
        f'<div class="scroll" tabindex="0" role="region" aria-label="{label}: {title}">'
        f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table></div>"
        f"{note}</div>"
    )


def _sign(tone: Tone) -> str:
    """The tone of a row as a character too: colour alone is lost on paper and to many readers."""
    if tone == "plain":
        return ""
    return f'<span class="sign" title="{WORDS[tone]}">{SIGNS[tone]}</span>'


def _cell(text: str, side: str, pad: int) -> str:
    """A cell, with invisible digits behind it that bring decimal points under each other.

    A hyphen is shown as a minus sign, and copied as the hyphen that spreadsheets understand.
    """
    point = "." if pad and "." not in text else ""
    spare = f'<span class="pad" aria-hidden="true">{point}{"0" * (pad - len(point))}</span>'
    shown = escape(text)
    if side == "r" and shown[:1] == "-" and shown[1:2].isdigit():
        shown = f'<span class="minus">-</span>{shown[1:]}'
    return f'<td class="{side}">{shown}{spare if pad else ""}</td>'


def _figure(plot: Plot, label: str) -> str:
    title = f"<b>{escape(plot.title)}.</b> " if plot.title else ""
    return (
        f"<figure>{render_svg(plot)}<figcaption><span>{label}</span>&#8195;{title}"
        f"{escape(plot.caption)}</figcaption></figure>"
    )


def _footer(rows: Sequence[tuple[str, str]]) -> str:
    return f"<footer>{_facts(rows)}</footer>" if rows else ""
