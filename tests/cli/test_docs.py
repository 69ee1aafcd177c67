"""The documentation is what the program does: generated pages, commands, the README's output."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from imucalib import cli
from imucalib.effects import catalogue
from worlds.places import ROOT

_SPEC = importlib.util.spec_from_file_location("examples", ROOT / "docs" / "examples.py")
assert _SPEC is not None
assert _SPEC.loader is not None
shown = importlib.util.module_from_spec(_SPEC)
sys.modules["examples"] = shown
_SPEC.loader.exec_module(shown)


def test_generated_pages_are_current() -> None:
    command = [sys.executable, str(ROOT / "docs" / "generate.py"), "--check"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_every_command_is_in_the_readme_or_its_pages() -> None:
    text = "\n".join(
        p.read_text(encoding="utf-8") for p in (ROOT / "README.md", *ROOT.glob("docs/**/*.md"))
    )
    for name in cli.COMMANDS:
        assert f"`{name}`" in text or f"imucal {name}" in text


@pytest.mark.parametrize("name", list(cli.COMMANDS))
def test_every_help_shows_an_example(name: str) -> None:
    result = CliRunner().invoke(cli.cli, [name, "--help"])
    assert result.exit_code == 0
    assert re.search(r"Examples?:\s+imucal " + name, result.output)


@pytest.mark.parametrize("name", list(cli.COMMANDS))
def test_every_help_fits_80_columns(name: str) -> None:
    command = cli.cli.get_command(click.Context(cli.cli), name)
    below = []
    if isinstance(command, click.Group):
        below = [(name, n) for n in command.list_commands(click.Context(command))]
    for words in ((name,), *below):
        shown = CliRunner().invoke(cli.cli, [*words, "--help"], terminal_width=80).output
        assert max(map(len, shown.splitlines())) <= 80, words


_NUMBER = re.compile(r"\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")


def _alike(one: str, other: str) -> bool:
    """The same words, and numbers to the 1e-6 that determinism promises: exports print nine digits,
    of which another order of sums changes the last."""
    numbers = [[float(x) for x in _NUMBER.findall(text)] for text in (one, other)]
    return _NUMBER.sub("0", one) == _NUMBER.sub("0", other) and numbers[0] == pytest.approx(
        numbers[1], rel=1e-6, abs=1e-9
    )


def test_a_page_may_differ_in_digits_that_nobody_promises_alone() -> None:
    assert _alike("x,0.0165712104,-3.5e-07\n", "x,0.0165712105,-3.5e-07\n")
    assert not _alike("by 0.32 mm", "by 0.31 mm")
    assert not _alike("x,0.01657121", "x,0.01657125")
    assert not _alike("by 0.32 mm", "by 0.32 mg")
    assert not _alike("-0.32", "0.32")


def _ran(page: Path, folder: Path, *, slow: bool) -> int:
    """Run a page's commands in their order, and compare the outputs that it shows."""
    ran = 0
    with shown.bench(folder, page):
        for example in shown.examples(page.read_text(encoding="utf-8")):
            if example.slow == slow:
                code, output = shown.run(example)
                assert code in example.codes, f"{example.line}: exit {code}\n{output}"
                if example.shown is not None:
                    said = f"{example.line}: stale, run make docs\n{output}"
                    assert _alike(output, example.shown), said
                ran += 1
    return ran


@pytest.mark.slow
@pytest.mark.parametrize("page", shown.PAGES, ids=lambda p: p.name)
def test_the_commands_of_every_page_run(page: Path, tmp_path: Path) -> None:
    _ran(page, tmp_path, slow=False)


@pytest.mark.slow
@pytest.mark.parametrize("page", shown.PAGES, ids=lambda p: p.name)
def test_the_slow_commands_of_every_page_run(page: Path, tmp_path: Path) -> None:
    _ran(page, tmp_path, slow=True)


def test_every_calibrator_is_shown_with_its_output() -> None:
    readme = shown.examples((ROOT / "README.md").read_text(encoding="utf-8"))
    assert {"lab", "actigraph", "array"} <= {e.arguments[0] for e in readme if e.shown}


def test_effects_named_in_the_documentation_exist() -> None:
    text = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^## (\w+)$", text, flags=re.M)) == set(catalogue())
