"""The card: worth, findings and steps first, one page of a terminal, no tick beside a caution."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imucalib.calibration.findings import Findings, Gain
from imucalib.report.document import Card, Document, Section, Table, Text, Tone, Worth
from imucalib.report.plots import gain_plot, projected
from imucalib.report.render.html import render_html
from imucalib.report.render.text import PAGE, render_text

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
    return Document("d", Text("v", tone), sections, card=CARD, terms=True)


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(st.integers(0, 200), st.integers(60, 160))
def test_a_report_with_a_card_is_one_page(rows: int, width: int) -> None:
    text = render_text(document("ok", rows), width, color=False)
    assert len(text.splitlines()) <= PAGE
    assert ("Not shown here" in text) == ("Long ─" not in text or "Short ─" not in text)
    whole = render_text(document("ok", rows), width, color=False, full=True)
    assert "Long ─" in whole
    assert "Short ─" in whole


def test_the_card_says_worth_findings_and_steps_before_the_sections() -> None:
    for shown in (render_html(document("ok")), render_text(document("ok"), 80, color=False)):
        order = ["± 0.42 deg", "Inclination zero", "Check the bench", "found"]
        places = [shown.index(text) for text in order]
        assert places == sorted(places)
    assert "<code>imucal apply calibration.yaml LOG</code>" in render_html(document("ok"))
    assert "a thousandth" in render_html(document("ok"))


def test_the_map_keeps_areas() -> None:
    """Equal numbers of evenly spread directions fall on equal areas of the map."""
    rng = np.random.default_rng(0)
    v = rng.standard_normal((40_000, 3))
    x, y = projected(v / np.linalg.norm(v, axis=1, keepdims=True))
    r2 = (x + np.where(x < 0, 1.55, -1.55)) ** 2 + y**2
    assert r2.max() <= 2.0 + 1e-9
    share = np.histogram(r2, np.linspace(0.0, 2.0, 9))[0] / len(v)
    assert np.abs(share - 0.125).max() < 0.006


@pytest.mark.parametrize(("low", "word"), [(0.1, "excludes"), (-0.1, "includes")])
def test_the_gains_picture_says_what_its_interval_holds(low: float, word: str) -> None:
    """Also where the log density, and not the error, proves the gain."""
    gain = Gain(2.0, 1.0, low, 1.9, True, "mg", nats=30.0, nats_low=9.0)
    (plot,) = gain_plot(Findings("explained", gain=gain))
    assert f"{word} zero; in log density +30.0 nats, at least +9.0" in plot.caption
    (bars,) = plot.series
    assert bars.names == ("before", "after", "gain, 95 %")
    np.testing.assert_array_equal(bars.y, [2.0, 1.0, 1.0])
    assert bars.low is not None
    assert (np.isnan(bars.low[0]), bars.low[2]) == (True, low)
    assert gain_plot(Findings("nothing missing")) == ()
