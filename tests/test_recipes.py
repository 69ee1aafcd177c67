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


#: Laws that find an addition by itself, but for what the page says that they ask for.
LAWS = ("tests/test_house.py", "tests/readers", "tests/exports/test_hostile_names.py", "-m", "",
        "-k", "test_house or jsonl or ridge or test_no_name_of_a_file")  # fmt: skip


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program with every addition of the page."""
    folder, bare = tmp_path_factory.mktemp("copy"), shutil.ignore_patterns("__pycache__")
    for name in ("src", "tests"):
        shutil.copytree(ROOT / name, folder / name, ignore=bare)
    shutil.copy(ROOT / "pyproject.toml", folder)
    (folder / "sample_logs").symlink_to(SAMPLES)
    for name, body in shown.files(PAGE).items():
        assert not (folder / name).exists(), f"{name} is there already: nothing would be added"
        (folder / name).write_text(body, encoding="utf-8")
    return folder


def called(folder: Path, module: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", module, *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder / "src")},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.slow
def test_every_recipe_runs_in_a_copy(copy: Path) -> None:
    for example in shown.examples(PAGE):
        done = called(copy, "imucalib", *example.arguments)
        assert done.returncode in example.codes, f"{example.line}\n{done.stderr}"


@pytest.mark.slow
def test_every_recipe_keeps_the_laws(copy: Path) -> None:
    done = called(copy, "pytest", "-q", "--tb=line", "-p", "no:cacheprovider", *LAWS)
    assert done.returncode == 0, done.stdout


def test_there_is_a_recipe_for_each_kind_of_addition() -> None:
    names = [name for name in shown.files(PAGE) if name.endswith(".py")]
    folders = {Path(name).parent.as_posix() for name in names}
    kinds = ("readers", "readers/devices", "exports", "calibrators", "cli")
    assert folders == {f"src/imucalib/{kind}" for kind in kinds}
    assert "docs/own_effect.md" in PAGE
