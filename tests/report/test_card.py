"""The card: worth, findings and steps first, one page of a terminal, no tick beside a caution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imucalib.calibration.findings import Findings, Gain
from imucalib.calibration.outcome import ErrorSummary, HeldOutError, Outcome
from imucalib.calibration.provenance import provenance_of
from imucalib.report.document import Card, Document, Plot, Section, Series, Table, Text, Tone, Worth
from imucalib.report.files import shown_dict
from imucalib.report.plots import gain_plot, projected
from imucalib.report.render.html import render_html
from imucalib.report.render.text import PAGE, render_text
from imucalib.report.sections import card_of, error_worth, refuted_words
from worlds.report_demo import demo_document

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


@pytest.mark.parametrize("tone", ["warning", "bad"])
def test_no_tick_stands_beside_a_caution(tone: Tone) -> None:
    for shown in (render_html(document(tone)), render_text(document(tone), 80, color=False)):
        assert "✓" not in shown
    assert "✓" in render_html(document("ok"))


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


def test_json_carries_the_card_and_the_figures() -> None:
    values = np.array([1.0, np.nan, 2.000001234])
    plot = Plot("p", "row", "mg", (Series("s", values, values, "points", names=("a", "b", "c")),))
    content = shown_dict(replace(document("ok"), sections=(Section("S", (plot,)),)))
    assert content["card"]["good_to"][0]["value"] == "± 0.42 deg"
    (figure,) = content["figures"]
    assert figure["series"][0]["y"] == [1.0, None, 2.0]
    assert figure["series"][0]["names"] == ["a", "b", "c"]
    assert len(shown_dict(demo_document())["figures"]) > 0


def test_worth_says_when_nothing_was_held_out() -> None:
    nan = float("nan")
    error = ErrorSummary("error, rms", "mg", 9.0, 2.0, 1.0, nan, HeldOutError(nan, nan, nan))
    assert error_worth(error, "x").value == "1 mg"
    assert "nothing was held out" in error_worth(error, "x").detail
    held = replace(error, held_out=HeldOutError(9.0, 3.0, 1.5))
    assert error_worth(held, "x", "positions").detail == (
        "rms on positions held out; raw reading 9, before the search 3"
    )


def test_the_map_keeps_areas() -> None:
    """Equal numbers of evenly spread directions fall on equal areas of the map."""
    rng = np.random.default_rng(0)
    v = rng.standard_normal((40_000, 3))
    x, y = projected(v / np.linalg.norm(v, axis=1, keepdims=True))
    r2 = (x + np.where(x < 0, 1.55, -1.55)) ** 2 + y**2
    assert r2.max() <= 2.0 + 1e-9
    share = np.histogram(r2, np.linspace(0.0, 2.0, 9))[0] / len(v)
    assert np.abs(share - 0.125).max() < 0.006


def test_a_slip_is_decided_before_anything_else() -> None:
    """Until rows that were exchanged are put back, other advice is about no sensor."""
    slip = "rows 3 and 15: their readings are exchanged; decide with --swap 3,15"
    made = provenance_of(path="t", sha256="", samples=3, mapping={}, settings={})
    error = ErrorSummary("error, rms", "mg", 400.0, 410.0, 410.0, 1.0, HeldOutError(4e2, 4e2, 4e2))
    outcome = Outcome("lab", (error,), made, undecided=(slip,), advice=("Add a position.",))
    card = card_of(outcome, (error_worth(error, "vector", "positions"),))
    assert card.found == (Text("rows 3 and 15: their readings are exchanged.", "bad"),)
    assert "--swap 3,15" in card.to_do[0]
    assert not any("Add a position" in step or "Use it" in step for step in card.to_do)
    assert card.good_to[0].value == "400 mg"


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


def test_a_card_of_a_result_that_passes_has_no_caution() -> None:
    left = replace(CARD, found=(Text("Left without a name: x.", "warning"),))
    for tone, shown in (("ok", "plain"), ("warning", "warning")):
        made = replace(document(tone), card=left).calm()  # type: ignore[arg-type]
        assert made.card is not None
        assert made.card.found[0].tone == shown


def test_what_stood_out_and_was_refused_by_other_data_is_told() -> None:
    gain = Gain(2.11, 2.2, -0.4, 0.2, False, "mg")
    words = refuted_words(Findings("nothing missing", refuted=("bias_step@record26",), gain=gain))
    assert "bias step, record 26 stood out by more than chance" in words
    assert "2.11 mg without, 2.2 with" in words
    assert refuted_words(Findings("nothing missing")) == "no candidate passes the search"
