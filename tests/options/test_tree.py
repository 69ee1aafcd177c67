"""A new option without a case fails here."""

from __future__ import annotations

import ast
from itertools import pairwise
from pathlib import Path

import click

from imucalib.cli import calibrators
from options.cases import cases
from options.listed import ELSEWHERE, LAWS, shown
from options.tree import commands, options_of, spellings


def test_every_option_has_a_test_of_what_it_does() -> None:
    missing = [" ".join(pair) for pair, tests in shown().items() if not tests]
    assert not missing, (
        "add a case to tests/options/cases for each of these; those that calibrators share are "
        f"made of the tables of calibrating_block.py: {missing}"
    )


#: Values that a plain call stands for, though their option has no default of its own.
STANDS = {"down", "down-hole", "horizontal", "+y", "clockwise", "deg"}
#: (command, option, value) -> the test of another room that shows it.
VALUES = {
    ("actigraph", "--arithmetic", "int32"): "calibrators/actigraph/test_published.py::"
    "test_as_published_writes_and_verifies",
    ("fleet", "--reference", "direction"): "cohort/test_fleet.py::"
    "test_devices_by_directions_are_a_fleet_too",
    **{
        (name, "--fail-on", gate): "calibration/test_calibration.py::test_gates_are_stricter"
        for name in calibrators()
        for gate in ("suspected", "unexplained", "caution")
    },
}


def test_every_value_that_can_be_chosen_has_a_case() -> None:
    missing = []
    for name, command in commands().items():
        typed = {w for c in cases() if c.command == name for w in (c.plain, c.whole)}
        said = {pair for words in typed for pair in pairwise(words)}
        said |= {tuple(w.split("=", 1)) for words in typed for w in words if "=" in w}
        for option, found in options_of(command).items():
            if isinstance(found.type, click.Choice):
                missing += [
                    (name, option, value)
                    for value in found.type.choices
                    if value not in {found.default, *STANDS}
                    and (name, option, value) not in VALUES
                    and not any((spelling, value) in said for spelling in found.opts)
                ]
    assert not missing


def test_cases_are_of_options_that_exist() -> None:
    there = {name: spellings(command) for name, command in commands().items()}
    unknown = [c.label for c in cases() if c.option not in there.get(c.command, ())]
    assert not unknown


def test_the_tests_named_elsewhere_exist() -> None:
    tests = Path(__file__).parents[1]
    names = [*ELSEWHERE.values(), *VALUES.values(), *(f"options/{law}" for law in LAWS.values())]
    for place, name in (text.split("::") for text in names):
        tree = ast.parse((tests / place).read_text(encoding="utf-8"))
        assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, name
