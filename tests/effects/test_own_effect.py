"""The worked example of docs/own_effect.md: found in the search, written, and applied."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from imucalib import cli, effects
from imucalib.calibrators.lab.position_table import write_position_table
from imucalib.calibrators.lab.simulation import BenchPlan, simulated_table
from imucalib.errors import UsageError
from worlds.places import ROOT

PAGE = ROOT / "docs" / "own_effect.md"


@pytest.fixture
def example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(effects, "_LOADED", {})
    found = re.search(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.S)
    assert found
    path = tmp_path / "crosstalk.py"
    path.write_text(found.group(1), encoding="utf-8")
    return path


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli.cli, [str(a) for a in arguments], standalone_mode=False)


def test_the_example_is_found_written_and_applied(example: Path, tmp_path: Path) -> None:
    effects.load_file(example)
    plan = BenchPlan("rings", 32, {"xy_into_z": (14.0,)}, setting=(0.05, 0.05))
    table = tmp_path / "bench.csv"
    write_position_table(simulated_table(plan, np.random.default_rng(2)), table)
    effects._LOADED.clear()

    out = tmp_path / "out"
    result = run("lab", table, "--effects", example, "-o", out, "--json", "-q", "--draws", 199)
    report = json.loads(result.stdout)
    (step,) = report["loop"]["steps"]
    assert "xy_into_z" in (step["effect"], *step["aliases"])
    assert abs(step["parameters"][0]["value"] - 14.0) < 4.5 * step["parameters"][0]["sd"]

    effects._LOADED.clear()
    rests = ROOT / "sample_logs" / "rests.mcap"
    arguments = ("apply", out / "calibration.yaml", rests, "-o", tmp_path / "c.csv", "-q")
    assert "--effects" in str(run(*arguments).exception)
    assert run(*arguments, "--effects", example).return_value == 0


@pytest.mark.parametrize(
    ("text", "words"),
    [("x = 1\n", "no EFFECTS"), ("1 / 0\n", "ZeroDivisionError"), ("EFFECTS = (\n", "SyntaxError")],
)
def test_files_that_are_no_effects(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "bad.py"
    path.write_text(text)
    with pytest.raises(UsageError, match=words):
        effects.load_file(path)


def test_a_name_that_is_taken(example: Path) -> None:
    example.write_text(
        example.read_text().replace('"xy_into_z",\n        "z reads', '"cubic",\n        "z reads')
    )
    with pytest.raises(UsageError, match="two effects are called 'cubic'"):
        effects.load_file(example)
