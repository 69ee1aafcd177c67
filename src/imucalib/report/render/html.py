"""A report as one HTML file: no script, no network, plots inside, readable on paper too."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from imucalib.report.document import Block, Card, Document, Facts, Plot, Section, Table, Text, Tone
from imucalib.report.render.columns import column_pads, squared
from imucalib.report.render.marks import escape
from imucalib.report.render.svg import render_svg

STYLE = r"""
:root{color-scheme:light dark;
--paper:#fdfdfb;--ink:#1b1f24;--soft:#59626d;--rule:#d5d9de;--hair:#e8ebee;--tint:#f4f5f3;
--accent:#1f4e79;
--ok:#1a6b3c;--ok-tint:#e9f4ec;--warning:#8a5300;--warning-tint:#fdf3df;
--bad:#a61b1b;--bad-tint:#fbeaea;
--series-0:#0072b2;--series-1:#d55e00;--series-2:#009e73;--series-3:#b8608f;--series-4:#c98a00;
--series-5:#3a9bd0;--series-6:#1b1f24}
@media (prefers-color-scheme:dark){:root{
--paper:#14171b;--ink:#e4e7ea;--soft:#9aa4ae;--rule:#3a424b;--hair:#272d34;--tint:#1b2026;
--accent:#8fbde6;
--ok:#6fcf97;--ok-tint:#15291d;--warning:#f0b95a;--warning-tint:#2e2412;
--bad:#ff8f87;--bad-tint:#331a1a;
--series-0:#56b4e9;--series-1:#e69f00;--series-2:#22b98c;--series-3:#e08fb8;--series-4:#f0e442;
--series-5:#f0803c;--series-6:#e4e7ea}}
*{box-sizing:border-box}
html{-webkit-text-size-adjust:100%;text-size-adjust:100%;scroll-padding-top:1rem}
body{margin:0;background:var(--paper);color:var(--ink);
font:16px/1.55 Charter,"Bitstream Charter","Sitka Text",Cambria,"Source Serif 4",Georgia,
"Liberation Serif",serif;text-rendering:optimizeLegibility;hanging-punctuation:first}
.sheet{max-width:46rem;margin:0 auto;padding:3rem 1.5rem 4rem}
h1,h2,h3,nav,table,.tiles,.facts,.verdict b,figcaption,caption,footer,svg,.kicker,.tag{
font-family:system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue","Noto Sans",
"Liberation Sans",Arial,sans-serif}
.kicker{margin:0;color:var(--soft);font-size:.75rem;letter-spacing:.09em;text-transform:uppercase}
h1{margin:.2rem 0 1.4rem;font-size:1.85rem;line-height:1.2;font-weight:650;letter-spacing:-.012em;
text-wrap:balance;overflow-wrap:anywhere}
h2{margin:3rem 0 1rem;padding-top:.7rem;border-top:1px solid var(--rule);font-size:1.18rem;
line-height:1.3;font-weight:650;overflow-wrap:anywhere;break-after:avoid}
h2 .number{display:inline-block;min-width:1.9rem;color:var(--soft);font-weight:400;
font-variant-numeric:tabular-nums}
p{margin:.8rem 0;overflow-wrap:break-word;text-wrap:pretty}
.verdict{margin:0 0 1.6rem;padding:.85rem 1.1rem;border-left:5px solid var(--accent);
background:var(--tint);font-size:1.08rem;line-height:1.45;
print-color-adjust:exact;-webkit-print-color-adjust:exact}
.verdict b{display:block;margin-bottom:.15rem;color:var(--accent);font-size:.78rem;
letter-spacing:.07em;text-transform:uppercase}
.card{margin:0 0 1.8rem;padding:.2rem 1.1rem .9rem;border:1px solid var(--rule);border-radius:6px;
break-inside:avoid-page}
.card h3{margin:1rem 0 .35rem;color:var(--soft);font-size:.75rem;font-weight:600;
letter-spacing:.07em;text-transform:uppercase}
.card p{margin:.3rem 0;font-size:.95rem;line-height:1.45}
.tiles{display:grid;grid-template-columns:repeat(auto-fit,minmax(11rem,1fr));gap:.9rem 1.4rem;
margin:0}
.tiles dt{color:var(--soft);font-size:.8125rem}.tiles dd{margin:0}
.tiles b{display:block;font-size:1.5rem;line-height:1.25;font-weight:650;letter-spacing:-.01em;
font-variant-numeric:tabular-nums}
.tiles span{display:block;color:var(--soft);font-size:.78rem;line-height:1.4}
.steps{margin:0;padding-left:1.3rem;font-size:.95rem;line-height:1.45}.steps li{margin:.2rem 0}
code,.command{font-family:ui-monospace,SFMono-Regular,Menlo,Consolas,"Liberation Mono",monospace;
font-size:.82em;overflow-wrap:anywhere}
.command{margin:0;padding:.5rem .7rem;background:var(--tint);white-space:pre-wrap;font-size:.78rem}
.terms h2{font-size:1rem}.terms .facts{font-size:.8125rem}
.ok{--tone:var(--ok);--tone-tint:var(--ok-tint)}
.warning{--tone:var(--warning);--tone-tint:var(--warning-tint)}
.bad{--tone:var(--bad);--tone-tint:var(--bad-tint)}
.verdict.ok,.verdict.warning,.verdict.bad{border-color:var(--tone);background:var(--tone-tint)}
.verdict.ok b,.verdict.warning b,.verdict.bad b{color:var(--tone)}
p.ok,p.warning,p.bad{padding-left:.85rem;border-left:3px solid var(--tone)}
.tag{color:var(--tone);font-weight:650;margin-right:.15em}
nav{margin:0 0 1rem;font-size:.875rem}
nav ol{margin:0;padding:0;list-style:none;columns:2 14rem;column-gap:2rem}
nav li{padding:.12rem 0;break-inside:avoid}
nav .number{display:inline-block;width:1.6rem;color:var(--soft);font-variant-numeric:tabular-nums}
a{color:var(--accent);text-decoration:none}
a:hover,a:focus-visible{text-decoration:underline;text-underline-offset:.18em}
.facts{display:grid;grid-template-columns:minmax(9rem,max-content) 1fr;margin:1rem 0;
font-size:.875rem;line-height:1.45;font-variant-numeric:tabular-nums}
.facts dt,.facts dd{margin:0;padding:.26rem 0;border-bottom:1px solid var(--hair)}
.facts dt{padding-right:1.5rem;color:var(--soft)}
.facts dd{overflow-wrap:anywhere}
.table{margin:1.5rem 0 1.7rem}
.scroll{overflow-x:auto;overscroll-behavior-x:contain}
@media (min-width:50rem){.scroll{width:max-content;min-width:100%;max-width:min(100vw - 4rem,72rem);
position:relative;left:50%;transform:translateX(-50%)}}
.scroll:focus-visible{outline:2px solid var(--accent);outline-offset:2px}
table{border-collapse:collapse;width:100%;font-size:.845rem;line-height:1.35;
font-variant-numeric:tabular-nums lining-nums;border-bottom:1.5px solid var(--ink)}
.label{margin:0 0 .45rem;font:600 .875rem/1.4 system-ui,-apple-system,"Segoe UI",Roboto,
"Helvetica Neue","Noto Sans","Liberation Sans",Arial,sans-serif;break-after:avoid}
.label span,figcaption span{color:var(--soft);font-weight:400}
thead th{padding:.36rem .7rem .34rem;border-top:1.5px solid var(--ink);
border-bottom:1px solid var(--ink);font-weight:600;text-align:left;vertical-align:bottom}
tbody td{padding:.27rem .7rem;border-bottom:1px solid var(--hair);vertical-align:top}
tbody tr:last-child td{border-bottom:0}
th:first-child,td:first-child{padding-left:.35rem}
th:last-child,td:last-child{padding-right:.35rem}
th.r,td.r{text-align:right;white-space:nowrap}
td.l{min-width:4rem}
tr.ok td,tr.warning td,tr.bad td{background:var(--tone-tint);
print-color-adjust:exact;-webkit-print-color-adjust:exact}
tr.ok td:first-child,tr.warning td:first-child,tr.bad td:first-child{
box-shadow:inset 3px 0 0 var(--tone);padding-left:.7rem}
tr .sign{color:var(--tone);font-weight:700;margin-right:.35em}
.pad{visibility:hidden;user-select:none;-webkit-user-select:none}
.minus{font-size:0}.minus::before{content:"\2212";font-size:.845rem}
.note,figcaption{font-family:system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",
"Noto Sans","Liberation Sans",Arial,sans-serif}
.note{margin:.45rem 0 0;color:var(--soft);font-size:.845rem;line-height:1.45}
figure{margin:1.6rem 0 1.9rem;break-inside:avoid}
figure svg{display:block;width:100%;height:auto;max-width:600px}
figure svg .axis{fill:var(--soft)}
figcaption{margin-top:.5rem;font-size:.845rem;line-height:1.45;max-width:42rem}
figcaption b{font-weight:600}
footer{margin-top:3.5rem;padding-top:.4rem;border-top:1.5px solid var(--ink);color:var(--soft)}
footer .facts{font-size:.78rem;margin:.4rem 0 0}
footer .facts dt,footer .facts dd{padding:.14rem 0;border:0}
@media (max-width:34rem){
body{font-size:15px}.sheet{padding:1.5rem 1rem 2.5rem}h1{font-size:1.45rem}
h2{margin-top:2.2rem}.facts{grid-template-columns:1fr}
.facts dt{padding-bottom:0;border-bottom:0;font-size:.8125rem}.facts dd{padding-top:0}
footer .facts dd{padding-bottom:.4rem}
td.l{white-space:nowrap;min-width:0}thead th,tbody td{padding-left:.4rem;padding-right:.4rem}
figure svg{font-size:14px}}
@media print{
:root{color-scheme:light;--paper:#fff;--ink:#000;--soft:#444;--rule:#999;--hair:#ddd;
--tint:#f4f4f4;--accent:#1f4e79;--ok:#1a6b3c;--ok-tint:#e9f4ec;--warning:#8a5300;
--warning-tint:#fdf3df;--bad:#a61b1b;--bad-tint:#fbeaea;
--series-0:#0072b2;--series-1:#d55e00;--series-2:#009e73;--series-3:#b8608f;--series-4:#c98a00;
--series-5:#3a9bd0;--series-6:#000}
@page{size:A4;margin:18mm 17mm 20mm;@bottom-right{content:counter(page) " / " counter(pages);
font:8pt sans-serif;color:#444}}
html{font-size:14px}body{font-size:10.5pt;line-height:1.45}.sheet{max-width:none;padding:0}
nav{display:none}a{color:inherit}.scroll{overflow:visible;width:auto;max-width:none;position:static;transform:none}
h2{margin-top:1.8rem}tr,.verdict,.facts dd{break-inside:avoid}thead{display:table-header-group}
figure{margin:.7rem 0 1rem}figure svg{max-width:104mm;font-size:12.5px}
.terms .facts{grid-template-columns:auto 1fr auto 1fr;font-size:8pt}.terms dt{padding-right:.6rem}
.terms dd{padding-right:1rem}
.card{break-inside:auto}p{orphans:3;widows:3}
footer{margin-top:1rem;break-before:avoid;break-inside:avoid}}
"""

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
