"""Help, pages and samples: current, short, with sources."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner

from imucalib import cli
from imucalib.cli.frame.options import PAGE, RARE
from imucalib.effects import catalogue
from imucalib.readers import read
from options.tree import commands
from worlds.places import ROOT, SAMPLES

NAMES = sorted(commands())


def shown(name: str, flag: str) -> list[str]:
    result = CliRunner().invoke(cli.cli, [*name.split(), flag], terminal_width=80)
    assert result.exit_code == 0, result.output
    return result.output.splitlines()


def spelled(lines: list[str]) -> set[str]:
    """Options that a help has a row of."""
    rows = [line.strip().split("  ")[0] for line in lines if line.startswith("  -")]
    return {word.strip(",") for row in rows for word in row.split() if word.startswith("-")}


@pytest.mark.parametrize("name", ["", *NAMES])
def test_help_is_a_page_of_80_columns(name: str) -> None:
    lines = shown(name, "--help")
    assert len(lines) <= PAGE, f"mark what is rare in cli/frame/options: {len(lines)} lines"
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize("name", NAMES)
def test_every_option_is_in_the_help_or_in_all_of_it(name: str) -> None:
    usual, every = shown(name, "--help"), shown(name, "--help-all")
    options = [p for p in commands()[name].params if isinstance(p, click.Option)]
    for option in options:
        assert set((*option.opts, *option.secondary_opts)) <= spelled(every), option.name
    rest = spelled(every) - spelled(usual)
    assert bool(rest) == ("--help-all" in spelled(usual))
    if rest:
        rare = {p.name for p in options if rest & set(p.opts)}
        assert f"{name} --help-all: {len(rare)} more options" in " ".join(usual)
        assert rare == {p.name for p in options} & {n for names in RARE.values() for n in names}


_SPEC = importlib.util.spec_from_file_location("examples", ROOT / "docs" / "examples.py")
assert _SPEC is not None
assert _SPEC.loader is not None
docs_shown = importlib.util.module_from_spec(_SPEC)
sys.modules["examples"] = docs_shown
_SPEC.loader.exec_module(docs_shown)


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
    with docs_shown.bench(folder, page):
        for example in docs_shown.examples(page.read_text(encoding="utf-8")):
            if example.slow == slow:
                code, output = docs_shown.run(example)
                assert code in example.codes, f"{example.line}: exit {code}\n{output}"
                if example.shown is not None:
                    said = f"{example.line}: stale, run make docs\n{output}"
                    assert _alike(output, example.shown), said
                ran += 1
    return ran


@pytest.mark.slow
@pytest.mark.parametrize("page", docs_shown.PAGES, ids=lambda p: p.name)
def test_the_commands_of_every_page_run(page: Path, tmp_path: Path) -> None:
    _ran(page, tmp_path, slow=False)


@pytest.mark.slow
@pytest.mark.parametrize("page", docs_shown.PAGES, ids=lambda p: p.name)
def test_the_slow_commands_of_every_page_run(page: Path, tmp_path: Path) -> None:
    _ran(page, tmp_path, slow=True)


def test_every_calibrator_is_shown_with_its_output() -> None:
    readme = docs_shown.examples((ROOT / "README.md").read_text(encoding="utf-8"))
    assert {"lab", "actigraph", "array"} <= {e.arguments[0] for e in readme if e.shown}


def test_effects_named_in_the_documentation_exist() -> None:
    text = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^## (\w+)$", text, flags=re.M)) == set(catalogue())


def test_every_sample_states_its_source() -> None:
    page = (SAMPLES / "README.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`([\w.]+)`", page))
    for path in SAMPLES.iterdir():
        if path.is_file() and path.name not in ("README.md", "demo.py"):
            short = path.stem.removeprefix("cave_")
            assert path.name in named or short in named, path.name
    for licence in re.findall(r"\((licences/\w+\.txt)\)", page):
        assert "Permission is hereby granted" in (SAMPLES / licence).read_text(encoding="utf-8")


def test_the_boards_part_is_of_its_log_and_leaves_its_first_rests_alone() -> None:
    whole, part = read(SAMPLES / "board.h5"), read(SAMPLES / "board_part.mcap")
    for name in ("imu0/acceleration", "imu7/angular_rate"):
        a, b = whole.channels[name], part.channels[name]
        start = int(np.searchsorted(a.t, 194.7))
        rest = slice(start, start + 300)
        np.testing.assert_allclose(a.values[rest], b.values[:300], rtol=1e-12)
        np.testing.assert_allclose(a.t[rest] - a.t[start], b.t[:300] - b.t[0], atol=1e-8)
