"""A name and the forms of its driver: which of them would do as well, and which are the name."""

from __future__ import annotations

from pathlib import Path

import pytest

from imucalib.calibrators.lab.position_table import read_position_table
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import run_lab
from worlds.plain_bench import Bench, Plan


@pytest.mark.slow
@pytest.mark.parametrize(
    ("planted", "seed", "strength", "first", "beside"),
    [
        # A saturation that sets in at 0.3 g is all but a cube, and the cube is the likelier by two
        # nats: the power of three, which is the cube itself, must not hide the others.
        ("response:xyz:soft_saturation:0.3", 70002, 13.9, "cubic", True),
        # A kink at a hundredth of a g is asymmetry, and no rival of it.
        ("asymmetry", 70007, 19.4, "asymmetry", False),
    ],
)
def test_a_name_is_certain_only_before_all_other_forms(
    planted: str, seed: int, strength: float, first: str, beside: bool, tmp_path: Path
) -> None:
    bench = Bench(Plan(seed, ((planted, strength),)))
    table = read_position_table(bench.write(tmp_path / "sheet.csv"))
    loop = run_lab(table, LabRequest(unit="mg", seed=0)).result.loop
    assert loop is not None
    step = loop.steps[0]
    assert step.effect == first
    assert any(a.startswith("shape@response") for a in step.aliases) == beside
    assert not (step.certain and beside)


@pytest.mark.slow
def test_an_error_of_the_tool_face_comes_back_after_a_turn(tmp_path: Path) -> None:
    """A third harmonic was a sine of 117 deg, which jumps where the turn closes."""
    bench = Bench(Plan(40071002, (("third_harmonic", 25.0),)))
    table = read_position_table(bench.write(tmp_path / "sheet.csv"))
    loop = run_lab(table, LabRequest(unit="mg", seed=0)).result.loop
    assert loop is not None
    assert loop.steps[0].effect == "shape@tool_face:tool_face:sine:120"
