"""The acceptance benchmark itself runs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_a_world_is_judged() -> None:
    command = [sys.executable, str(ROOT / "benchmarks" / "closed_loop"), "norm", "--count", "1"]
    done = subprocess.run([*command, "--each"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "clean" in done.stderr
    assert "| clean | 1 |" in done.stdout
