"""Help is one page; what it leaves out is in --help-all, and nothing is in neither."""

from __future__ import annotations

import click
import pytest
from click.testing import CliRunner

from imucalib import cli
from imucalib.cli.options import PAGE, RARE
from options.tree import commands

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
    assert len(lines) <= PAGE, f"mark what is rare in cli/paged_help: {len(lines)} lines"
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


def test_every_rare_option_exists() -> None:
    known = {p.name for command in commands().values() for p in command.params}
    assert {n for names in RARE.values() for n in names} <= known
