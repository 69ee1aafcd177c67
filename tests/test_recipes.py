"""What CONTRIBUTING.md adds to the program runs, written into a copy of it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from worlds.places import ROOT, SAMPLES, script

PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
shown = script("docs/examples.py")


@pytest.mark.slow
def test_every_recipe_runs_in_a_copy(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "src", tmp_path / "src", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "sample_logs").symlink_to(SAMPLES)
    for name, body in shown.files(PAGE).items():
        assert not (tmp_path / name).exists(), f"{name} is there already: nothing would be added"
        (tmp_path / name).write_text(body, encoding="utf-8")
    for example in shown.examples(PAGE):
        done = subprocess.run(
            [sys.executable, "-m", "imucalib", *example.arguments],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(tmp_path / "src")},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode in example.codes, f"{example.line}\n{done.stderr}"


def test_there_is_a_recipe_for_each_kind_of_addition() -> None:
    folders = {Path(name).parent.as_posix() for name in shown.files(PAGE) if "/" in name}
    kinds = ("readers", "readers/devices", "exports", "calibrators", "cli")
    assert folders == {f"src/imucalib/{kind}" for kind in kinds}
    assert "docs/own_effect.md" in PAGE
