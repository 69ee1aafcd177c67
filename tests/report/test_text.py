"""The terminal report: verdict first, brief sections only, never wider than the terminal."""

from __future__ import annotations

import re

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rich.cells import cell_len

from imucalib.report.document import Document, Plot, Section, Table, Text, Tone
from imucalib.report.render.text import PAGE, render_text
from worlds.report_demo import demo_document
from worlds.report_strategies import DOCUMENTS

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
def test_demo_report_reads_on_one_page(width: int) -> None:
    document = demo_document()
    text = render_text(document, width, color=False)
    lines = text.splitlines()
    assert lines[0] == document.title
    assert lines[2].startswith("! CAUTION: The 12-parameter model")
    assert len(lines) <= PAGE
    whole = render_text(document, width, color=False, full=True)
    told = " ".join(text[text.index("Not shown here") :].split())
    for section in document.sections:
        shown = section.title not in told
        tables = [block for block in section.blocks if isinstance(block, Table)]
        for row in (row for table in tables for row in table.rows if section.brief):
            assert any(_in_order(row, line) for line in whole.splitlines())
            assert not shown or any(_in_order(row, line) for line in lines)
    assert "Error over inclination" not in text
    assert "Detail, Readings; --full shows all" in told
    assert not re.search(r"\bnan\b", text)


def _in_order(cells: tuple[str, ...], line: str) -> bool:
    return re.search(r"\s+".join(map(re.escape, cells)) + r"\s*$", line) is not None


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
