"""The table of a cohort: what a spreadsheet opens is text, never a formula."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from imucalib.cohort.entries import write_table


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
