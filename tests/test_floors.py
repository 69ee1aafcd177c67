"""The architecture as a law: floors, import order, sizes, and what library code never does."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1] / "src" / "imucalib"

#: Floor of every module or package, by name below `imucalib`; the longest matching name counts.
#: A file imports only from lower floors or its own, and never in a circle while it loads.
FLOORS: dict[str, int] = {
    "": 0,  # the package itself: its version
    "errors": 0,
    "units": 0,
    "significant_digits": 0,  # digits of a number, for sentences on every floor; imports nothing
    "recording": 1,
    "parameter": 1,
    "context": 1,
    "mapping": 1,
    "conventions": 1,
    "readers": 2,
    "writers": 2,
    "references": 2,
    "windows": 2,
    "tails": 2,
    "thermal_history": 3,
    "stillness": 2,
    "segments": 2,
    "position_table": 2,
    "observations": 3,
    "bench": 3,
    "inspection": 3,
    "inspection_advice": 3,
    "runs": 3,
    "calibration_points": 3,
    "effect": 3,
    "array_effect": 3,
    "effects": 4,
    "array_effects": 5,  # it takes the accelerometers' effects from the catalogue
    "model": 5,
    "balance": 6,
    "fit": 6,
    "identifiability": 6,
    "estimators": 7,
    "convergence": 7,
    "starting_point": 7,
    "evidence": 8,
    "evidence_gram": 8,
    "evidence_grid": 8,
    "candidates": 8,
    "held_out": 8,
    "record_errors": 8,
    "uncertainty": 8,
    "attitude": 8,
    "simulate": 8,
    "matrices": 8,
    "loop": 9,  # what the closed loop is asked for and finds; loop_records: the wrong records
    "loop_records": 9,
    "loop_search": 9,
    "noise_checks": 9,
    "closed_loop": 9,
    "cross_fit": 9,
    "calibration": 10,
    "calibration_file": 10,
    "calibration_series": 10,
    "application": 10,
    "batch": 3,
    "cohort_table": 3,
    "__main__": 14,
    "yaml_text": 10,
    "outcome": 10,
    "calibrators": 11,
    "report": 12,
    "cli": 13,
}
#: Longest module and function (its docstring left out), in lines.
MODULE_LINES, FUNCTION_LINES = 260, 45
VAGUE = {"utils", "util", "helpers", "helper", "common", "manager", "misc", "tools"}


def _name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


SOURCES = {_name(path): path for path in sorted(ROOT.rglob("*.py"))}
TREES = {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in SOURCES.items()}


def _floor(name: str) -> int | None:
    while name:
        if name in FLOORS:
            return FLOORS[name]
        name = name.rpartition(".")[0]
    return None


def _imports(tree: ast.Module, *, at_load: bool = False) -> Iterator[str]:
    """Full names that a module imports, inside functions too unless `at_load`."""
    for node in tree.body if at_load else ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            module = "." * node.level + (node.module or "")
            yield from (f"{module}.{alias.name}" for alias in node.names)


def _own_imports(name: str, *, at_load: bool = False) -> set[str]:
    """Modules of this package that a module imports, by the longest name that is a module."""
    found = set()
    for full in _imports(TREES[name], at_load=at_load):
        assert not full.startswith("."), f"{name}: relative import {full}"
        if full.split(".")[0] != "imucalib":
            continue
        target = full.partition(".")[2]
        while target and target not in SOURCES:
            target = target.rpartition(".")[0]
        found.add(target)
    return found


def _functions(tree: ast.AST, inside: str = "") -> Iterator[tuple[str, int]]:
    for node in ast.iter_child_nodes(tree):
        name = inside
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            name = f"{inside}.{node.name}"
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node, clean=False)
            yield name, (node.end_lineno or 0) - node.lineno + 1 - len((text or "").splitlines())
        yield from _functions(node, name)


def test_every_module_has_a_floor() -> None:
    homeless = [name for name in SOURCES if name and _floor(name) is None]
    assert not homeless, f"give these a floor in FLOORS: {homeless}"


def test_imports_go_down() -> None:
    climbs = [
        f"{name} (floor {_floor(name)}) imports {target} (floor {_floor(target)})"
        for name in SOURCES
        if name
        for target in _own_imports(name)
        if target and (_floor(target) or 0) > (_floor(name) or 0)
    ]
    assert not climbs, climbs


def test_no_import_circles() -> None:
    graph = {name: _own_imports(name, at_load=True) - {name, ""} for name in SOURCES if name}
    assert list(TopologicalSorter(graph).static_order())


def test_a_climbing_import_is_seen() -> None:
    tree = ast.parse("def f():\n    from imucalib.closed_loop import close_loop\n")
    TREES["errors_test"], SOURCES["errors_test"] = tree, ROOT
    try:
        assert _own_imports("errors_test") == {"closed_loop"}
    finally:
        del TREES["errors_test"], SOURCES["errors_test"]


def _calls(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            yield ast.unparse(node.func)


def test_library_code_neither_prints_nor_exits() -> None:
    for name, tree in TREES.items():
        if _floor(name) == FLOORS["cli"]:
            continue
        bad = {"print", "sys.exit", "exit", "quit", "os._exit", "sys.stdout.write"} & set(
            _calls(tree)
        )
        assert not bad, f"{name} calls {bad}"
        assert "SystemExit" not in ast.unparse(tree), name
        assert not any(full.split(".")[0] == "click" for full in _imports(tree)), name


def test_modules_are_short() -> None:
    for name, path in SOURCES.items():
        lines = len(path.read_text(encoding="utf-8").splitlines())
        assert lines <= MODULE_LINES, f"{name} has {lines} lines, at most {MODULE_LINES}"


def test_functions_are_short() -> None:
    for name, tree in TREES.items():
        for function, lines in _functions(tree):
            assert lines <= FUNCTION_LINES, f"{name}{function} has {lines} lines"


def test_modules_have_names_with_a_meaning() -> None:
    vague = [name for name in SOURCES if VAGUE & set(name.replace("_", ".").split("."))]
    assert not vague


@pytest.mark.parametrize("module", ["imucalib", "imucalib.cli"])
def test_importing_is_light(module: str) -> None:
    heavy = ("numpy", "scipy", "h5py", "mcap", "zstandard", "lz4", "rich", "ruamel")
    code = f"import sys, {module}; print([m for m in {heavy!r} if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
