"""The card on top of a report, and files that come all or none."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucalib.calibration.findings import Findings, Gain
from imucalib.report.document import Card, Document, Section, Table, Text, Tone, Worth
from imucalib.report.plots import gain_plot, projected
from imucalib.report.render.html import render_html
from imucalib.report.render.text import render_text
from worlds.command import run
from worlds.places import SAMPLES

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


@pytest.fixture(scope="module")
def tools(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Two devices, each calibrated by itself, and six rests of the first."""
    folder = tmp_path_factory.mktemp("tools")
    for name in ("cave_ai", "cave_jd"):
        run("lab", SAMPLES / f"{name}.csv", "--reference", "norm", "--no-loop", "-q", "-o",
            folder / name)  # fmt: skip
    rows = (SAMPLES / "cave_ai.csv").read_text().splitlines()
    (folder / "rests.csv").write_text("\n".join(rows[:9]) + "\n")
    return {
        "ai": folder / "cave_ai" / "calibration.yaml",
        "jd": folder / "cave_jd" / "calibration.yaml",
        "rests": folder / "rests.csv",
    }


def card(*words: object) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(run(*words, "--json").stdout)["card"]
    return found


def test_a_check_that_passes_says_what_it_would_have_seen(tools: dict[str, Path]) -> None:
    told = card("check", tools["ai"], tools["rests"], "--limit", "20mg")
    (worth,) = told["good_to"]
    assert worth["quantity"] == "see a change of bias"
    assert "limit 20 mg, as stated" in worth["detail"]
    assert told["found"][0].startswith("Nothing shows")
    assert "imucal apply" in told["to_do"][0]
    assert "imucal check" in told["command"]


def test_a_fleet_says_what_a_device_is_good_to(tmp_path: Path) -> None:
    tables = [SAMPLES / f"cave_{n}.csv" for n in ("ai", "bi", "fb")]
    out = tmp_path / "fleet"
    done = run("fleet", *tables, "--reference", "norm", "--only", "quadratic", "--draws", "99",
               "-o", out)  # fmt: skip
    content = json.loads((out / "report.json").read_text())
    names = [w["quantity"] for w in content["card"]["good_to"]]
    assert names == ["all devices", "the worst device"]
    worst = max(content["devices"], key=lambda d: d["final_mg"])
    assert content["card"]["good_to"][1]["value"] == f"{worst['final_mg']:.3g} mg"
    assert worst["name"] in content["card"]["good_to"][1]["detail"]
    assert "Quadratic, in every device" in content["card"]["found"][0]
    assert "Good to ─" in done.stdout
    page = (out / "report.html").read_text()
    assert 'class="card"' in page
    assert "imucal fleet" in page
    assert content["figures"]


def test_an_undecided_check_names_the_rests(tools: dict[str, Path]) -> None:
    told = card("check", tools["ai"], tools["rests"], "--limit", "0.02mg")
    assert "Nothing shows" in told["found"][0]
    assert "Record these rests" in told["to_do"][0] or "accept a wider" in told["to_do"][0]
