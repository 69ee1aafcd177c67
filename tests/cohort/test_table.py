"""A cohort's table: its quality columns, and text that is never a formula."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from imucalib.cohort.entries import Entry, quality_of, rows, write_table
from worlds.command import run
from worlds.places import SAMPLES


@pytest.mark.slow
def test_a_row_tells_a_manager_what_to_know() -> None:
    done = run("actigraph", SAMPLES / "wrist_day.csv.gz", "--no-loop", "--json", "-q")
    report = json.loads(done.stdout)
    found = quality_of(report)
    assert found["rate_hz"] == 1.0
    assert found["hours_recorded"] == pytest.approx(24.0, abs=0.01)
    assert 0.0 < found["hours_worn"] <= 24.0
    assert found["axes_seen_both_ways"] == "yz"
    assert found["error_after"] < found["error_before"]
    assert found["enmo_after_mg"] < found["enmo_before_mg"]
    assert found["worst_direction"] in {c["name"] for c in report["sphere"]}
    assert found["serial"] is None
    report["notes"].append("GENEActiv 012345")
    assert quality_of(report)["serial"] == "012345"
    (row,) = rows((Entry("a", "k", done.return_value or 0, 1.0, "", report),))
    assert row["what_to_do"] == report["card"]["to_do"][0]
    (lost,) = rows((Entry("b", "k", 4, 1.0, "no rest. wear it through a night", None),))
    assert (lost["status"], lost["what_to_do"]) == ("undetermined", "wear it through a night")
    assert {"status", "hours_worn", "what_to_do", "bias_x", "held_out_final"} <= set(row)


@pytest.mark.parametrize("text", ["=1+1", "+1", "-cmd|' /C calc'!A0", "@SUM(A1)", "\t=1"])
def test_no_cell_is_a_formula(text: str, tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    write_table(({"input": text, text: "x", "offset": -0.5},), path)
    with path.open(newline="", encoding="utf-8") as file:
        head, row = csv.reader(file)
    assert head[1] == row[0] == f"'{text}"
    assert float(row[2]) == -0.5


def test_no_text_ends_a_row(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    write_table(({"input": "a\r=1+1\n=2"},), path)
    with path.open(newline="", encoding="utf-8") as file:
        assert [row for row in csv.reader(file)] == [["input"], ["a =1+1\n=2"]]
