"""Documents as HTML, SVG and text: complete, contained, readable."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from rich.cells import cell_len

import imucalib
from imucalib.report.plots import project
from imucalib.report.render.document import (
    Card,
    Document,
    Facts,
    Plot,
    Section,
    Series,
    Table,
    Text,
    Tone,
    Worth,
)
from imucalib.report.render.html import render_html
from imucalib.report.render.svg import (
    Axis,
    assign_slots,
    linear_axis,
    log_axis,
    plot_axes,
    render_svg,
)
from imucalib.report.render.table import decimal_pads
from imucalib.report.render.text import PAGE, render_text
from worlds.places import SAMPLES
from worlds.report_strategies import DOCUMENTS, PLOTS


@pytest.fixture(scope="module")
def made() -> Document:
    """A report of every kind of block."""
    return imucalib.lab(SAMPLES / "bench.csv", loop=False).document


class _Page(HTMLParser):
    """Tags and attributes as a browser sees them."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]


def _check_contained(html: str) -> None:
    page = _Page(html)
    ids = {value for _, name, value in page.attributes if name == "id"}
    assert not {"script", "link", "img", "iframe", "object", "base"} & set(page.tags)
    for _, name, value in page.attributes:
        assert name != "src"
        assert not name.startswith("on")
        if name.endswith("href"):
            assert value.startswith("#")
            assert value[1:] in ids
    style = html.split("<style>")[1].split("</style>", maxsplit=1)[0]
    assert "url(" not in style
    assert "@import" not in style


def _tree(html: str) -> ET.Element:
    return ET.fromstring(html.removeprefix("<!DOCTYPE html>\n"))


def _text(element: ET.Element) -> str:
    return "".join(element.itertext())


@pytest.mark.slow
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(DOCUMENTS)
def test_any_document_is_well_formed_and_self_contained(document: Document) -> None:
    html = render_html(document)
    _tree(html)
    _check_contained(html)


def test_a_report_is_complete_and_small(made: Document) -> None:
    html = render_html(made)
    assert len(html.encode()) < 250_000
    assert not re.search(r"\bnan\b|\binf\b", html, re.IGNORECASE)
    text = _text(_tree(html))
    for section in made.sections:
        assert section.title in text
        for block in section.blocks:
            if isinstance(block, Facts):
                assert all(name in text and value in text for name, value in block.rows)
            else:
                assert (block.text if isinstance(block, Text) else block.title) in text
    assert all(value in text for _, value in (*made.footer, ("", made.verdict.text)))


def test_text_cannot_become_markup() -> None:
    evil = '</style></title><script src="http://example.org/x.js">alert(1)</script>&amp;\'"'
    x = np.arange(2.0)
    blocks = (
        Text(evil, "bad"),
        Facts(((evil, evil),)),
        Table(evil, (evil, evil), ((evil, "-" + evil),), "lr", evil, {0: "ok"}),
        Plot(evil, evil, evil, (Series(evil, x, x, "points", names=(evil, evil)),), evil),
    )
    html = render_html(Document(evil, Text(evil), (Section(evil, blocks),), ((evil, evil),)))
    _check_contained(html)
    assert _text(_tree(html)).count(evil) >= 12


def test_a_command_and_an_option_are_whole_wherever_they_stand() -> None:
    note = "`imucal apply` undoes it"
    table = Table("t", ("a",), (("1",),), "r", note)
    facts = Facts((("gravity", "standard; --latitude gives the place's"),))
    card = Card((Worth("gravity", "9.8", "assumed: --latitude"),), (), ())
    html = render_html(
        Document("d", Text("v"), (Section("s", (table, facts, Text("or --gravity."))),), card=card)
    )
    assert "<code>imucal apply</code> undoes it" in html
    assert html.count('<span class="option">--latitude</span>') == 2
    assert '<span class="option">--gravity.</span>' in html


@pytest.mark.parametrize(
    ("cells", "pads"),
    [
        (("1.25", "-13.5", "200"), (0, 1, 3)),
        (("—", "1.5", "", "12"), (0, 0, 0, 2)),
        (("1.2e-5", "3.25"), (0, 0)),
        (("3 mg", "3.25"), (0, 0)),
        (("0.1", "0.123456789"), (0, 0)),
        ((), ()),
    ],
)
def test_decimal_points_align(cells: tuple[str, ...], pads: tuple[int, ...]) -> None:
    assert decimal_pads(cells) == pads


NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?")


GEOMETRY = ("d", "x", "y", "width", "height", "viewBox", "transform")


def _elements(svg: str, tag: str) -> list[ET.Element]:
    return list(ET.fromstring(svg).iter("{http://www.w3.org/2000/svg}" + tag))


def _line(plot: Plot) -> str:
    """The path of the first line of the series, without legend and axes."""
    group = next(g for g in _elements(render_svg(plot), "g") if "--series-0" in g.get("style", ""))
    return str(group[0].get("d"))


def test_before_and_after_have_one_colour_on_every_page() -> None:
    one = np.arange(3.0)
    labels = ("noise", "before", "after"), ("raw reading", "corrected"), ("after", "mean", "before")
    for names in labels:
        plot = _plot(*(Series(name, one, one, "points") for name in names))
        slots = dict(zip(names, assign_slots(plot), strict=True))
        assert len(set(slots.values())) == len(names)
        assert slots.get("before", 1) == 1
        assert slots.get("after", slots.get("corrected")) == 2


def _points(path: str) -> np.ndarray:
    return np.array(re.findall(r"[ML](-?[\d.]+),(-?[\d.]+)", path), dtype=float)


def _plot(*series: Series, **options: bool) -> Plot:
    return Plot("title", "x", "y", series, **options)


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(PLOTS)
def test_any_plot_is_well_formed_and_finite(plot: Plot) -> None:
    root = ET.fromstring(render_svg(plot))
    _, _, width, height = (float(v) for v in root.attrib["viewBox"].split())
    for element in root.iter():
        for name in GEOMETRY:
            value = element.get(name, "")
            assert not re.search("nan|inf", value, re.IGNORECASE)
            assert all(abs(float(v)) <= max(width, height) + 60 for v in NUMBER.findall(value))
    assert not any(key.endswith(("href", "src")) for e in root.iter() for key in e.attrib)


@settings(max_examples=300, deadline=None)
@given(st.floats(-1e9, 1e9), st.floats(-9, 9).map(lambda e: 10.0**e), st.integers(2, 9))
def test_tick_labels_say_their_values(low: float, span: float, count: int) -> None:
    assume(span >= 1e-4 * abs(low))
    axis = linear_axis(low, low + span, count)
    assert max(2, int(count / 2.5)) <= len(axis.ticks) <= max(count + 1, 5)
    assert len(set(axis.labels)) == len(axis.labels)
    told = [_told(axis, label) for label in axis.labels]
    np.testing.assert_allclose(told, axis.ticks, atol=1e-6 * span + 1e-14 * abs(low), rtol=0)
    assert max(len(label) for label in axis.labels) <= 9


def _told(axis: Axis, label: str) -> float:
    """The value that a reader computes from a label and the note of its axis."""
    plain = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹−", "-0123456789-")
    note = re.fullmatch(r"(?:×10(\S+))?", axis.note.translate(plain))
    assert note
    return float(label.translate(plain)) * (10.0 ** int(note[1]) if note[1] else 1.0)


def test_what_is_counted_has_no_halves() -> None:
    for n in (1, 2, 3, 60):
        one = np.arange(1.0, n + 1.0)
        x_axis, _ = plot_axes(_plot(Series("calibrations", one, one, "points")), (500, 300), (7, 6))
        assert len(x_axis.ticks) >= min(n, 2)
        assert np.all(x_axis.ticks == np.round(x_axis.ticks))


@pytest.mark.parametrize("ends", [(0.28, 1.75), (0.65, 2.5), (3.9, 4.3), (0.5, 5.0), (1e-3, 1e4)])
def test_a_logarithmic_axis_shows_that_it_is_one(ends: tuple[float, float]) -> None:
    axis = log_axis(*np.log10(ends), count=6)
    assert len(axis.ticks) >= 3
    assert all(
        float(text) == pytest.approx(at) for text, at in zip(axis.labels, axis.ticks, strict=True)
    )


def test_gap_breaks_the_line_and_a_lone_point_stays_visible() -> None:
    y = np.array([1.0, 2.0, np.nan, 4.0, np.nan, 5.0, 6.0])
    path = _line(_plot(Series("a", np.arange(7.0), y, "line")))
    assert path.count("M") == 3
    assert path.count("L") == 2
    assert "h0" in path


def test_long_line_is_thinned_but_keeps_extremes_ends_and_gaps() -> None:
    n = 300_000
    y = np.random.default_rng(3).standard_normal(n)
    y[123_456], y[200_001] = 50.0, -40.0
    y[150_000:160_000] = np.nan
    plot = _plot(Series("a", np.arange(n) / 100, y, "line"))
    path = _line(plot)
    assert len(render_svg(plot)) < 60_000
    assert path.count("M") == 2
    short = _plot(
        Series("a", np.array([0.0, 1.0, n / 100 - 0.01]), np.array([0, 50.0, -40]), "line")
    )
    kept, whole = _points(path), _points(_line(short))
    np.testing.assert_allclose(kept.min(axis=0), whole.min(axis=0), atol=0.11)
    np.testing.assert_allclose(kept.max(axis=0), whole.max(axis=0), atol=0.11)


def test_equal_scales_keep_a_circle_round() -> None:
    angle = np.linspace(0, 2 * np.pi, 181)
    circle = Series("a", 7 + 3 * np.cos(angle), 3 * np.sin(angle), "line")
    width, height = np.ptp(_points(_line(_plot(circle, equal=True))), axis=0)
    assert width == pytest.approx(height, abs=0.3)
    width, height = np.ptp(_points(_line(_plot(circle))), axis=0)
    assert width > 1.5 * height


def test_log_axis_drops_what_it_cannot_show_and_keeps_error_bars() -> None:
    y = np.array([0.01, -1.0, 0.0, 10.0])
    path = _line(_plot(Series("a", np.arange(4.0), y, "line"), log_y=True))
    assert path.count("M") == 2
    bars = Series("a", np.arange(4.0), y, "points", y - 0.02, y + 0.02)
    assert _line(_plot(bars, log_y=True)).count("V") == 4


ANSI = re.compile(r"\x1b\[[\d;]*m")


def _lines(*blocks: Text | Table | Plot, width: int = 80) -> list[str]:
    document = Document("d", Text("v"), (Section("s", blocks),))
    return render_text(document, width, color=False).splitlines()


@pytest.mark.slow
@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(DOCUMENTS, st.integers(40, 140))
def test_no_line_is_wider_than_the_terminal(document: Document, width: int) -> None:
    plain = render_text(document, width, color=False)
    assert max(cell_len(line) for line in plain.split("\n")) <= width
    assert not re.search(r"[\x00-\x09\x0b-\x1f\x7f-\x9f]", plain)
    assert ANSI.sub("", render_text(document, width, color=True)) == plain


@pytest.mark.parametrize("width", [80, 120])
def test_a_report_without_a_card_reads_on_one_page(made: Document, width: int) -> None:
    document = replace(made, card=None)
    text, whole = (render_text(document, width, color=False, full=full) for full in (False, True))
    lines = text.splitlines()
    assert lines[0] == document.title
    assert len(lines) <= PAGE
    told = " ".join(text[text.index("Not shown here") :].split())
    assert told.endswith("--full shows all")
    for section in document.sections:
        tables = [block for block in section.blocks if isinstance(block, Table)]
        cells = {cell for table in tables for row in table.rows for cell in row}
        numbers = {cell for cell in cells if NUMBER.fullmatch(cell)}
        assert numbers <= set(whole.split()), section.title
        assert section.title in told or numbers <= set(text.split()), section.title
    assert not re.search(r"\bnan\b", text)


def test_a_column_of_nothing_takes_a_cell_all_the_same() -> None:
    header = ("", "", "", "", "0" * 30, "")
    assert max(map(cell_len, _lines(Table("", header, (), "l" * 6), width=40))) <= 40


def test_wide_table_is_split_and_no_number_is_cut() -> None:
    header = ("position", *(f"column {k}" for k in range(14)))
    rows = tuple((f"p{i}", *(f"{i}.{k:05d}" for k in range(14))) for i in range(3))
    lines = _lines(Table("t", header, rows, "l" + "r" * 14))
    text = "\n".join(lines)
    assert all(cell in text for row in rows for cell in row)
    assert sum(line.startswith("p1 ") for line in lines) >= 2


def test_text_cannot_steer_the_terminal() -> None:
    evil = "a\x1b[2Jb\x9b1mc\u202ed\re"
    document = Document(evil, Text(evil, "bad"), (Section(evil, (Text(evil),)),), ((evil, evil),))
    text = render_text(document, 80, color=False)
    assert "a?[2Jb?1mc?d" in text
    assert not set("\x1b\x9b\u202e\r") & set(text)


def asked_for(count: int, tones: dict[int, Tone], title: str = "Asked") -> Section:
    """A section that a page keeps: a table of many rows."""
    rows = tuple((f"row {k}", f"{k}") for k in range(count))
    return Section(title, (Table("t", ("what", "value"), rows, "lr", "A note.", tones),), kept=True)


def test_a_table_that_was_asked_for_is_cut_to_the_page_and_says_so() -> None:
    document = Document("d", Text("v"), (asked_for(500, {400: "bad", 2: "ok"}),))
    page = render_text(document, 80, color=False)
    lines = page.splitlines()
    assert PAGE - 4 <= len(lines) <= PAGE
    rows = [int(line.split()[-1]) for line in lines if "row " in line and "rows" not in line]
    # What must not be missed stays, the others in their order from the first.
    assert rows == [*range(len(rows) - 1), 400]
    assert "✗ row 400" in page
    assert f"{500 - len(rows)} more rows: --full. A note." in page
    whole = render_text(document, 80, color=False, full=True)
    assert sum("row " in line for line in whole.splitlines()) == 500
    assert "more rows" not in whole


CARD = Card(
    (Worth("inclination", "± 0.42 deg", "one reading, worst attitude"),),
    (Text("Inclination zero: 1.96 ± 0.16 deg.", "ok"),),
    ("Check the bench.", "Use it: `imucal apply calibration.yaml LOG`."),
    "imucal lab table.csv",
)


def document(tone: Tone, rows: int = 3) -> Document:
    cells = tuple((str(k), "x") for k in range(rows))
    table = Table("t", ("a", "b"), cells, "rl", tones={1: "ok"})
    sections = (Section("Long", (table, Text("found", "ok"))), Section("Short", (Text("s", "ok"),)))
    return Document("d", Text("v", tone), sections, card=CARD)


def test_the_card_says_worth_findings_and_steps_before_the_sections() -> None:
    for shown in (
        render_html(document("ok")),
        render_text(document("ok"), 80, color=False, full=True),
    ):
        order = ["± 0.42 deg", "Inclination zero", "Check the bench", "found"]
        places = [shown.index(text) for text in order]
        assert places == sorted(places)
    assert "<code>imucal apply calibration.yaml LOG</code>" in render_html(document("ok"))
    option = replace(CARD, to_do=("Take it: `imucal export c.yaml --to kalibr`",))
    page = render_html(replace(document("ok"), card=option))
    assert 'export c.yaml <span class="option">--to</span> kalibr' in page
    assert page.index("Take it") > page.index('role="status"')


def test_the_map_keeps_areas() -> None:
    """Equal numbers of evenly spread directions fall on equal areas of the map."""
    rng = np.random.default_rng(0)
    v = rng.standard_normal((40_000, 3))
    x, y = project(v / np.linalg.norm(v, axis=1, keepdims=True))
    r2 = (x + np.where(x < 0, 1.55, -1.55)) ** 2 + y**2
    assert r2.max() <= 2.0 + 1e-9
    share = np.histogram(r2, np.linspace(0.0, 2.0, 9))[0] / len(v)
    assert np.abs(share - 0.125).max() < 0.006
