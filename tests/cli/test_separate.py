"""`imucal design --separate` as it is typed: plans that are filled in and read, and bad input."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucalib.errors import UnreadableInput
from worlds.command import run
from worlds.warm_bench import HEADING, WarmBench

pytestmark = pytest.mark.slow


def separate(folder: Path, *options: object) -> tuple[int, dict[str, Any]]:
    done = run("design", "--separate", folder, "--json", "-q", *options)
    assert done.exception is None, done.exception
    return done.return_value, json.loads(done.stdout)


@pytest.fixture(scope="module")
def warm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibrated bench whose temperature effect has rivals."""
    at = tmp_path_factory.mktemp("warm")
    (at / "bench.csv").write_text(WarmBench(np.random.default_rng(6)).first())
    assert run("lab", at / "bench.csv", "-o", at / "out", "-q").return_value in (0, 5)
    return at


@pytest.mark.slow
def test_a_plan_that_is_filled_in_ends_the_ambiguity(warm: Path) -> None:
    code, plan = separate(warm / "out", "-o", warm / "plan.csv", "--force")
    rivals = plan["ambiguities"][0]["rivals"]
    assert (code, plan["ended"]) == (0, True)
    assert "temperature_bias" in rivals
    assert len(rivals) > 1
    assert all(share >= 90.0 for share in plan["ambiguities"][0]["certain_percent"].values())
    judged = run("design", warm / "plan.csv", "--json", "-q")
    assert judged.return_value in (0, 4)  # few rests by themselves leave parameters open
    assert len(json.loads(judged.stdout)["positions"]) == len(plan["ambiguities"][0]["rests"])
    unfilled = run("lab", warm / "plan.csv")
    assert isinstance(unfilled.exception, UnreadableInput)
    with (warm / "plan.csv").open() as lines:
        rows = list(csv.DictReader(lines))
    set_to = [np.array([float(r[name]) for r in rows]) for name in
              ("inclination", "tool_face", "temperature")]  # fmt: skip
    # A lag that could pass for the two is kept from it: what was before each rest is set too.
    assert set(rows[0]) == {"inclination", "tool_face", "temperature", "temperature_before",
                            *HEADING.split(",")[3:]}  # fmt: skip
    assert any(row["temperature_before"] != row["temperature"] for row in rows)
    more = WarmBench(np.random.default_rng(5)).lines(*set_to)
    whole = (warm / "bench.csv").read_text() + "\n".join(more) + "\n"
    (warm / "grown.csv").write_text(whole)
    assert run("lab", warm / "grown.csv", "-o", warm / "grown", "-q").return_value == 0
    steps = json.loads((warm / "grown" / "report.json").read_text())["loop"]["steps"]
    assert [s["effect"] for s in steps] == ["temperature_bias"]
    # What is left beside it is laws of the same temperature.
    assert all(re.search("@bias:temperature|^thermal_", name) for name in steps[0]["aliases"])
    code, after = separate(warm / "grown")
    assert code == 0
    # What the plan was for is told apart; a play of 6 °C, which it did not know of, has its own.
    left = {name for one in after["ambiguities"] for name in one["rivals"]}
    assert not left & set(rivals) - {"temperature_bias"}


@pytest.mark.slow
def test_temperatures_that_are_farther_apart_promise_more(warm: Path) -> None:
    def least(*options: object) -> float:
        one = separate(warm / "out", *options)[1]["ambiguities"][0]
        assert len(one["rests"]) == 4
        return min(p["then"] for p in one["apart"])

    assert least("--temperatures", "10,40") > 1.5 * least("--temperatures", "22,28")
    _, plan = separate(warm / "out", "--temperatures", "10,40")
    assert {r["degC"] for r in plan["ambiguities"][0]["rests"]} <= {"10", "40"}


def test_another_power_up_promises_less(warm: Path) -> None:
    same, other = (
        min(p["then"] / len(plan["ambiguities"][0]["rests"]) ** 0.5
            for p in plan["ambiguities"][0]["apart"])
        for plan in (separate(warm / "out")[1],
                     separate(warm / "out", "--between-sessions", "2mg")[1])
    )  # fmt: skip
    # Of one plan it is less (tests/posterior/test_separation.py); each is best of its exchanges.
    assert other < 1.02 * same
