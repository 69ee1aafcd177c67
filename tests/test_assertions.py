"""Every test asserts something, and none ends before it has."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
SOURCES = {path: ast.parse(path.read_text(encoding="utf-8")) for path in TESTS.rglob("*.py")}
#: Calls that assert: pytest's, numpy's, hypothesis' rules, and a schema's.
ASSERTING = ("raises", "warns", "fail", "validate")


def _functions(tree: ast.AST) -> Iterator[ast.FunctionDef]:
    return (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef))


def _called(function: ast.FunctionDef) -> set[str]:
    """Last names of what it calls."""
    calls = (node.func for node in ast.walk(function) if isinstance(node, ast.Call))
    return {ast.unparse(call).rpartition(".")[2] for call in calls}


def _asserts(function: ast.FunctionDef) -> bool:
    called = _called(function)
    return any(isinstance(node, ast.Assert) for node in ast.walk(function)) or any(
        name in ASSERTING or name.startswith("assert_") for name in called
    )


def asserting() -> set[str]:
    """Names of the functions of the tests that assert, or call one that does."""
    every = [f for tree in SOURCES.values() for f in _functions(tree)]
    found = {f.name for f in every if _asserts(f)}
    while more := {f.name for f in every if f.name not in found and _called(f) & found}:
        found |= more
    return found


def _tests(tree: ast.Module) -> Iterator[ast.FunctionDef]:
    return (f for f in tree.body if isinstance(f, ast.FunctionDef) and f.name.startswith("test_"))


def _returns(function: ast.FunctionDef) -> bool:
    """Whether it ends early; what functions inside it return is theirs."""
    inner = {id(n) for f in _functions(function) if f is not function for n in ast.walk(f)}
    return any(isinstance(n, ast.Return) and id(n) not in inner for n in ast.walk(function))


@pytest.mark.slow
def test_every_test_asserts() -> None:
    known = asserting()
    silent = [
        f"{path.relative_to(TESTS)}::{test.name}"
        for path, tree in SOURCES.items()
        if path.name.startswith("test_")
        for test in _tests(tree)
        if test.name not in known
    ]
    assert not silent


def test_no_test_ends_early() -> None:
    early = [
        f"{path.relative_to(TESTS)}::{test.name}"
        for path, tree in SOURCES.items()
        if path.name.startswith("test_")
        for test in _tests(tree)
        if _returns(test)
    ]
    assert not early, early


def test_a_silent_test_and_an_early_end_are_seen() -> None:
    tree = ast.parse("def test_a():\n    x = f()\n    if x:\n        return\n    g(x)\n")
    (test,) = _tests(tree)
    assert not _asserts(test)
    assert _returns(test)
