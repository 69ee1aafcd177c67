"""A new option without a case fails here."""

from __future__ import annotations

import ast
from pathlib import Path

from options.cases import cases
from options.listed import ELSEWHERE, LAWS, shown
from options.tree import commands, spellings


def test_every_option_has_a_test_of_what_it_does() -> None:
    missing = [" ".join(pair) for pair, tests in shown().items() if not tests]
    assert not missing, f"add a case to tests/options/cases for each of: {missing}"


def test_cases_are_of_options_that_exist() -> None:
    there = {name: spellings(command) for name, command in commands().items()}
    unknown = [c.label for c in cases() if c.option not in there.get(c.command, ())]
    assert not unknown


def test_the_tests_named_elsewhere_exist() -> None:
    tests = Path(__file__).parents[1]
    names = [*ELSEWHERE.values(), *(f"options/{law}" for law in LAWS.values())]
    for place, name in (text.split("::") for text in names):
        tree = ast.parse((tests / place).read_text(encoding="utf-8"))
        assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, name
