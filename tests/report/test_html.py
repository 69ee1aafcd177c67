"""The HTML report is one well-formed, small, self-contained file that holds everything."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from imucalib.report.document import Document, Facts, Plot, Section, Series, Table, Text
from imucalib.report.render.html import render_html
from imucalib.report.render.table import decimal_pads
from worlds.report_demo import demo_document
from worlds.report_strategies import DOCUMENTS


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


def test_demo_report_is_complete_and_small() -> None:
    document = demo_document()
    html = render_html(document)
    assert len(html.encode()) < 150_000
    assert not re.search(r"\bnan\b|\binf\b", html, re.IGNORECASE)
    text = _text(_tree(html))
    for section in document.sections:
        assert section.title in text
        for block in section.blocks:
            if isinstance(block, Text):
                assert block.text in text
            elif isinstance(block, Facts):
                assert all(name in text and value in text for name, value in block.rows)
            else:
                assert block.title in text
    assert document.verdict.text in text
    assert text.index(document.verdict.text) < text.index("Summary")
    assert all(value in text for _, value in document.footer)


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
