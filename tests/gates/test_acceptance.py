"""The acceptance benchmark itself runs: each kind of trial that has a way of its own, once."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("scenario", ["clean", "junk"])
def test_a_trial_is_judged(scenario: str, tmp_path: Path) -> None:
    command = [sys.executable, str(ROOT / "benchmarks" / "closed_loop"), "--only", "sheets"]
    command += ["--scenarios", scenario, "--scale", "0.001", "--jobs", "1", "--keep", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert len((tmp_path / "sheets.jsonl").read_text(encoding="utf-8").splitlines()) == 1
    assert f"| {scenario}" in done.stdout
