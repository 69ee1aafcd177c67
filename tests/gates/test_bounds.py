"""The gates' own numbers, that tests on rates use them, and that the acceptance benchmark runs."""

from __future__ import annotations

import ast
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gates.bounds import CHANCE, POWER, WORSE, at_most

TESTS = Path(__file__).parents[1]


def tail(most: int, runs: int, rate: float) -> float:
    """P(more than most), summed term by term."""
    return 1.0 - sum(
        math.comb(runs, k) * rate**k * (1.0 - rate) ** (runs - k) for k in range(most + 1)
    )


@pytest.mark.parametrize(("runs", "due"), [(40, 0.05), (120, 0.02), (900, 0.004)])
def test_a_gate_is_as_strict_as_chance_allows(runs: int, due: float) -> None:
    gate = at_most(runs, due)
    assert gate.false_failure == pytest.approx(tail(gate.most, runs, due), abs=1e-9)
    assert gate.false_failure <= CHANCE < tail(gate.most - 1, runs, due)
    assert tail(gate.most, runs, gate.seen) == pytest.approx(POWER, abs=1e-6)
    assert tail(gate.most, runs, WORSE * due) >= POWER


def test_it_fails_as_often_as_it_says() -> None:
    gate, rng = at_most(40, 0.05), np.random.default_rng(0)
    failed = np.mean(rng.binomial(40, 0.05, 20_000) > gate.most)
    assert failed == pytest.approx(gate.false_failure, abs=4 * math.sqrt(0.02 * 0.98 / 20_000))
    seen = np.mean(rng.binomial(40, gate.seen, 20_000) > gate.most)
    assert seen == pytest.approx(POWER, abs=0.012)


def test_too_few_runs_make_no_gate() -> None:
    with pytest.raises(ValueError, match="make more runs"):
        at_most(24, 0.05)


def loose(source: str) -> list[str]:
    """Counts of bad runs held against a number that somebody chose."""
    return [
        ast.unparse(node)
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Compare)
        and isinstance(node.left, ast.Call)
        and ast.unparse(node.left.func) == "sum"
        and isinstance(node.ops[0], ast.LtE)
        and isinstance(node.comparators[0], ast.Constant)
    ]


@pytest.mark.slow
def test_counts_of_bad_runs_are_held_against_gates() -> None:
    assert loose("assert sum(t.bad for t in trials) <= 4") == ["sum((t.bad for t in trials)) <= 4"]
    found = {p: loose(p.read_text(encoding="utf-8")) for p in TESTS.rglob("test_*.py")}
    del found[Path(__file__)]
    assert not {str(p): each for p, each in found.items() if each}


ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_a_world_is_judged() -> None:
    command = [sys.executable, str(ROOT / "benchmarks" / "closed_loop"), "norm", "--count", "1"]
    done = subprocess.run([*command, "--each"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "clean" in done.stderr
    assert "| clean | 1 |" in done.stdout
