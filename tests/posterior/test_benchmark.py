"""The acceptance benchmark: its worlds share no code with the program, which accepts their files,
and its algebra is that of least squares."""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from worlds.places import ROOT

FOLDER = ROOT / "benchmarks" / "closed_loop"
#: The only modules that may know the program, and the array's, whose worlds are still its own.
KNOWS = {"told.py", "trial.py", "array_world.py"}


@pytest.fixture(scope="module", autouse=True)
def on_the_path() -> Iterator[None]:
    sys.path.insert(0, str(FOLDER))
    yield
    sys.path.remove(str(FOLDER))


def module(name: str) -> ModuleType:
    return importlib.import_module(name)


def test_worlds_import_nothing_of_the_program() -> None:
    for path in FOLDER.glob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        found = {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
        found |= {n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
        assert path.name in KNOWS or not any(n.startswith("imucalib") for n in found), path.name


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "row"),
    [("bench", "slip"), *product(("bench", "norm", "worn"), ("clean", "15-40", "two", "outside"))],
)
def test_the_command_accepts_what_a_world_writes(kind: str, row: str, tmp_path: Path) -> None:
    judge, world = module("judge"), module("draws").drawn(kind, row, 12)
    code, _, said = judge.ran([*world.write(tmp_path), "-o", str(tmp_path / "out"), "--no-loop"])
    assert code in (0, 5) or (row == "slip" and "--fix" in said), said
    assert module("told").read_report(tmp_path / "out").exit_code == code
    seen = world.attitudes()
    assert judge.errors(world, seen, tmp_path)["error"] >= 0.5 * world.errors(seen).oracle


@pytest.mark.parametrize("kind", ["bench", "norm", "worn"])
def test_a_planted_effect_is_as_long_as_asked(kind: str) -> None:
    """By a second way: what the oracle's chi-square loses without it."""
    world = module("draws").drawn(kind, "15-40", 3)
    (name, aim), *_ = world.recipe.planted.items()
    size = world.sensor.size[name]
    free = None if kind == "bench" else world.truth()
    change = world.observed(world.planted_columns([name], world.c, free)) @ size
    precision = np.linalg.inv(world.variance())
    base = world.observed(world.base_columns(world.truth()))
    crossed = base.T @ precision @ change
    inside = crossed @ np.linalg.pinv(base.T @ precision @ base, rcond=1e-12) @ crossed
    assert np.sqrt(change @ precision @ change - inside) == pytest.approx(aim, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["bench", "norm"])
def test_the_oracle_is_right_and_the_base_is_not(kind: str) -> None:
    """Over many draws of the noise the strong effect costs the base model more."""
    draws = module("draws")
    pairs = []
    for seed in range(6):
        world = draws.drawn(kind, "15-40", seed)
        found = world.errors(world.attitudes())
        pairs.append(found.base / found.oracle)
    assert np.median(pairs) > 1.3


@pytest.mark.slow
def test_a_slip_is_undone_by_its_repair() -> None:
    """What the repair says stands in the sheet that the slip was made in."""
    slips, bench, world = module("slips"), module("bench"), module("world")
    for seed, kind in enumerate(slips.KINDS):
        made = bench.Table(world.Recipe("bench", "slip", seed, slip=kind))
        right, dial = np.round(made.reading, 3), made.c
        assert (
            (made.noted != right).any()
            or (made.dial[:, 1] != dial.tool_face).any()
            or (made.dial[:, 0] != dial.inclination).any()
        )
        for cell, _, value in (one.partition("=") for one in made.repair if ":" in one):
            row, _, column = cell.partition(":")
            held = {"inclination": dial.inclination, "tool_face": dial.tool_face}
            held |= {a: right[:, k] for k, a in enumerate("xyz")}
            assert held[column][int(row) - 1] == pytest.approx(float(value))
