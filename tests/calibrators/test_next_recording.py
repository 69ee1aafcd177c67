"""The table of what to record next."""

from __future__ import annotations

import csv

from imucalib.calibrators.next_recording import plan_table


def test_ambiguities_that_set_different_things_share_one_table() -> None:
    angles = {"inclination": ["0.0", "45.0"], "tool_face": ["10.0", "20.0"]}
    warm = {"inclination": ["90.0"], "tool_face": ["0.0"], "temperature": ["40"]}
    rows = list(csv.reader(plan_table([angles, warm], ["Gx", "Gy", "Gz"]).splitlines()))
    assert rows[0] == ["inclination", "tool_face", "temperature", "Gx", "Gy", "Gz"]
    assert rows[1:] == [
        ["0.0", "10.0", "", "", "", ""],
        ["45.0", "20.0", "", "", "", ""],
        ["90.0", "0.0", "40", "", "", ""],
    ]
    assert plan_table([], ["x", "y", "z"]) == ""
