"""Histories of checks: a line that is none is told with its number, and nothing is read of it."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucalib.calibration.checking.e_value import SCHEMA, Look, counted_once, read_history
from imucalib.errors import UnreadableInput, UsageError


def line(of: str = "abc", schema: str = SCHEMA, **other: Any) -> str:
    block = {
        "p": 0.4, "misfit_m_per_s2": [0.1, 0.2], "noise_covariance": [[1.0, 0.0], [0.0, 1.0]],
        "jacobian": [[1.0], [2.0]], "changes": {"bias": [[1.0], [0.5]]}, **other,
    }  # fmt: skip
    return json.dumps({"schema": schema, "calibration_sha256": of, "sensors": {"": block}})


def test_a_line_comes_back_as_numbers(tmp_path: Path) -> None:
    path = tmp_path / "h.jsonl"
    path.write_text(line() + "\n" + line(p=0.01) + "\n", encoding="utf-8")
    first, second = read_history(path, "abc")
    look = first.sensors[""]
    assert look.value.tolist() == [0.1, 0.2]
    assert look.changes["bias"].tolist() == [[1.0], [0.5]]
    assert (look.p, second.sensors[""].p) == (0.4, 0.01)


@pytest.mark.parametrize(
    "damaged",
    [
        line(misfit_m_per_s2=[[0.1, 0.2]]),
        line(misfit_m_per_s2=[0.1, math.nan]),
        line(noise_covariance=[1.0, 1.0]),
        line(jacobian=[[1.0], [math.inf]]),
        line(changes={"bias": [1.0, 0.5]}),
        line(p="likely"),
        line(schema="another/1"),
        "[]",
    ],
)
def test_a_damaged_line_is_told_by_its_number(tmp_path: Path, damaged: str) -> None:
    path = tmp_path / "h.jsonl"
    path.write_text(line() + "\n" + damaged + "\n", encoding="utf-8")
    with pytest.raises(UnreadableInput) as told:
        read_history(path, "abc")
    assert "line 2" in str(told.value)


def test_another_calibrations_history_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "h.jsonl"
    path.write_text(line(of="other") + "\n", encoding="utf-8")
    with pytest.raises(UsageError, match="another calibration"):
        read_history(path, "abc")
    assert read_history(tmp_path / "none.jsonl", "abc") == ()


def test_readings_that_come_again_count_once() -> None:
    """The same log checked twice, one that goes on, and another day's."""

    def look(*value: float) -> Look:
        n = len(value)
        return Look(np.array(value), np.eye(n), np.ones((n, 1)), {"bias": np.ones((n, 1))}, 0.5)

    monday, more, tuesday = look(0.1, 0.2), look(0.1, 0.2, 0.7), look(0.3, 0.2)
    assert counted_once([monday, monday], tuesday.value) == (monday,)
    assert counted_once([monday, tuesday], more.value) == (tuesday,)
    assert counted_once([monday, more, tuesday], look(0.9).value) == (more, tuesday)
    assert counted_once([tuesday], tuesday.value) == ()
