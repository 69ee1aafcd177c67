"""The worked example of docs/own_effect.md: found in the search, written, and applied."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from imucalib import effects
from imucalib.calibrators.lab.position_table import write_position_table
from imucalib.calibrators.lab.simulation import BenchPlan, simulate_table
from imucalib.errors import UsageError
from worlds.command import run
from worlds.places import ROOT

PAGE = ROOT / "docs" / "own_effect.md"


@pytest.fixture
def example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(effects, "_LOADED", {})
    found = re.search(r"```python[^\n]*\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.S)
    assert found
    path = tmp_path / "crosstalk.py"
    path.write_text(found.group(1), encoding="utf-8")
    return path


@pytest.mark.slow
def test_the_example_is_found_written_and_applied(example: Path, tmp_path: Path) -> None:
    effects.load_file(example)
    plan = BenchPlan("rings", 32, {"xy_into_z": (14.0,)}, setting=(0.05, 0.05))
    table = tmp_path / "bench.csv"
    write_position_table(simulate_table(plan, np.random.default_rng(2)), table)
    effects._LOADED.clear()

    out = tmp_path / "out"
    result = run("lab", table, "--effects", example, "-o", out, "--json", "-q")
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


_OWN = """
from dataclasses import replace
import numpy as np
from imucalib.core.effect import Action, Response
from imucalib.core.effect import Parameter
from imucalib.effects import named
own = replace(named("bias"), name="own_bias")
class Plain:
    name = sentence = equation = source = identify = "plain"
    stage, channel, needs = "sensor", "acceleration", ()
    parameters = staticmethod(lambda context: (Parameter("k", "mg", 1.0, 9.0),))
    missing = staticmethod(lambda context: "")
    def act(self, theta, truth, context):
        n = context.n
        return Action(np.zeros((n, 1, 3)), np.zeros((n, 1, 3, 1)), np.zeros((n, 1, 3, 3)))
def plain(**changed):
    return type("Changed", (Plain,), changed)()
"""


@pytest.mark.parametrize(
    ("offered", "words"),
    [
        ("own", "EFFECTS is a Response, not a tuple"),
        ("(0,)", "item 1 of EFFECTS is an int, not an effect"),
        ("(own, Plain)", "item 2 of EFFECTS is the class Plain"),
        ("(own, own)", "two effects are called 'own_bias'"),
        ("(plain(source=None),)", "effect 'plain': its source is missing"),
        ("(plain(stage='sensing'),)", "its stage is 'sensing'.*fixture, mounting, sensor"),
        ("(plain(needs='temperature'),)", "its needs are not a tuple"),
        ("(plain(act=None),)", "no function act"),
        ("(plain(missing=lambda s, c: None),)", "missing.. gives a NoneType"),
        ("(plain(parameters=lambda s, c: ()),)", "no parameters"),
        ("(plain(parameters=lambda s, c: (Parameter('k', 'mg', -1, 9),)),)", "k: typical -1"),
        ("(plain(parameters=lambda s, c: (Parameter('k', 'mg', 1, 9),) * 2),)", "the same name"),
        ("(plain(act=lambda s, *a: 0),)", "gives an int, not an Action"),
        ("(plain(act=lambda s, *a: 1 / 0),)", "'plain': it fails with ZeroDivisionError"),
        (
            "(plain(act=lambda s, *a: Action(np.zeros((5, 3)), np.zeros(1), np.zeros(1))),)",
            r"delta of its action has the shape \(5, 3\), not \(5, 1, 3\)",
        ),
        (
            "(plain(act=lambda s, *a: Action(np.ones((5, 1, 3)), np.ones((5, 1, 3, 1)), "
            "np.ones((5, 1, 3, 3)))),)",
            "does something at parameters of zero",
        ),
        (
            "(plain(act=lambda s, *a: Action(np.zeros((5, 1, 3)), np.full((5, 1, 3, 1), np.nan), "
            "np.ones((5, 1, 3, 3)))),)",
            "d_theta of its action is not finite",
        ),
    ],
)
def test_a_malformed_file_names_the_effect_and_what_is_wrong(
    tmp_path: Path, offered: str, words: str
) -> None:
    path = tmp_path / "bad.py"
    path.write_text(f"{_OWN}\nEFFECTS = {offered}\n")
    with pytest.raises(UsageError, match=words) as caught:
        effects.load_file(path)
    assert caught.value.where == str(path)
    assert caught.value.remedy


def test_an_effect_of_its_own_shape_is_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(effects, "_LOADED", {})
    path = tmp_path / "good.py"
    path.write_text(f"{_OWN}\nEFFECTS = [own, plain()]\n")
    assert list(effects.load_file(path)) == ["own_bias", "plain"]


def test_a_name_that_is_taken(example: Path) -> None:
    example.write_text(
        example.read_text().replace('"xy_into_z",\n        "z reads', '"cubic",\n        "z reads')
    )
    with pytest.raises(UsageError, match="two effects are called 'cubic'"):
        effects.load_file(example)
