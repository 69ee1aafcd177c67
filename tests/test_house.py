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

#: Floor of every room, by its name below `imucalib`. A file imports only from lower floors or its
#: own, and never in a circle while it loads.
FLOORS: dict[str, int] = {
    "": 0,  # the package itself: its version
    "errors": 0,
    "units": 0,
    "significant_digits": 0,
    "atomic_file": 0,
    "file_hash": 0,
    "question": 0,
    "arrays": 0,
    "data": 0,
    "recording": 1,
    "core": 2,
    "readers": 2,
    "rests": 3,
    "effects": 3,
    "writers": 3,
    "estimators": 4,
    "inspection": 4,
    "posterior": 5,
    "calibration": 6,
    "exports": 7,
    "calibrators": 7,
    "cohort": 8,
    "report": 9,
    "api": 10,
    "cli": 10,
    "__main__": 11,
}
#: Most Python files of a folder.
FOLDER_FILES = 20
#: Longest module and function (its docstring left out), in lines.
MODULE_LINES, FUNCTION_LINES = 600, 60
VAGUE = {"utils", "util", "helpers", "helper", "common", "manager", "misc", "tools"}


def _name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


SOURCES = {_name(path): path for path in sorted(ROOT.rglob("*.py"))}
TREES = {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in SOURCES.items()}


def _floor(name: str) -> int | None:
    return FLOORS.get(name.partition(".")[0])


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


def _folder(name: str) -> str:
    return SOURCES[name].parent.relative_to(ROOT).as_posix().removeprefix(".")


def test_folders_import_one_another_one_way() -> None:
    ways = {
        (_folder(name), _folder(target))
        for name in SOURCES
        for target in _own_imports(name)
        if _folder(name) != _folder(target) and _folder(name) and _folder(target)
    }
    tied = {(a, b) for a, b in ways if (b, a) in ways and a < b}
    assert not tied, f"these import each other: {tied}"


def test_the_root_holds_rooms_and_the_ground() -> None:
    ground = {"__init__", "__main__"} | {n for n, floor in FLOORS.items() if n and not floor}
    assert {path.stem for path in ROOT.glob("*.py")} == ground
    rooms = {path.parent.relative_to(ROOT).parts[0] for path in ROOT.glob("*/**/*.py")}
    assert rooms == set(FLOORS) - ground - {""}


def _folders() -> Iterator[tuple[str, list[str]]]:
    for folder in sorted({path.parent for path in ROOT.rglob("*.py")}):
        yield folder.relative_to(ROOT).as_posix(), sorted(p.stem for p in folder.glob("*.py"))


def test_folders_are_rooms() -> None:
    for folder, files in _folders():
        assert len(files) <= FOLDER_FILES, f"{folder}: {len(files)} files"


def test_tests_mirror_the_rooms() -> None:
    beside = {"costs", "gates", "goldens", "mutants", "options", "oracle", "worlds", "."}
    here = Path(__file__).parent
    folders = {p.parent.relative_to(here).as_posix() for p in here.rglob("*.py")}
    lost = [f for f in folders if f.split("/")[0] not in beside and not (ROOT / f).is_dir()]
    assert not lost, lost


def test_no_import_circles() -> None:
    graph = {name: _own_imports(name, at_load=True) - {name, ""} for name in SOURCES if name}
    assert list(TopologicalSorter(graph).static_order())


def test_a_climbing_import_is_seen() -> None:
    tree = ast.parse("def f():\n    from imucalib.posterior.closed_loop.closed import close_loop\n")
    TREES["errors_test"], SOURCES["errors_test"] = tree, ROOT
    try:
        assert _own_imports("errors_test") == {"posterior.closed_loop.closed"}
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


#: From so many on, arguments are given by their names, so that two numbers cannot change places.
NAMED = 7


def test_many_arguments_are_given_by_name() -> None:
    for name, tree in TREES.items():
        if name.startswith("effects"):  # an effect is data: its words stand in their order
            continue
        long = [
            f"{node.lineno}: {ast.unparse(node.func)}"
            for node in ast.walk(tree)
            if isinstance(node, ast.Call) and len(node.args) >= NAMED
        ]
        assert not long, f"{name}: {long}"


def test_one_alias_a_kind_of_array() -> None:
    for name, tree in TREES.items():
        made = [n for n in tree.body if isinstance(n, ast.Assign)]
        own = [ast.unparse(n) for n in made if ast.unparse(n.value) == "NDArray[np.float64]"]
        assert name == "arrays" or not own, f"{name}: {own}"


def test_constants_stand_above_what_uses_them() -> None:
    """But for those that are made by the module's own functions and classes."""
    for name, tree in TREES.items():
        own = {node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
        late, made = list[str](), set[str]()
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                made.add(node.name)
            elif made and isinstance(node, ast.Assign | ast.AnnAssign):
                names = [part for part in ast.walk(node) if isinstance(part, ast.Name)]
                if own & {part.id for part in names if isinstance(part.ctx, ast.Load)}:
                    own |= {part.id for part in names if isinstance(part.ctx, ast.Store)}
                else:
                    late.append(ast.unparse(node)[:60])
        assert not late, f"{name}: {late}"


def test_modules_have_names_with_a_meaning() -> None:
    vague = [name for name in SOURCES if VAGUE & set(name.replace("_", ".").split("."))]
    assert not vague


@pytest.mark.parametrize("module", ["imucalib", "imucalib.cli"])
def test_importing_is_light(module: str) -> None:
    heavy = ("numpy", "scipy", "h5py", "mcap", "zstandard", "lz4", "rich", "ruamel", "jinja2")
    code = f"import sys, {module}; print([m for m in {heavy!r} if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


@pytest.mark.parametrize("room", ["core", "effects", "estimators", "posterior"])
def test_the_model_is_imported_without_the_readers(room: str) -> None:
    modules = [name for name in SOURCES if name.split(".")[0] == room]
    load = "; ".join(f"import imucalib.{name}" for name in modules)
    code = (
        f"import sys; {load}; print([m for m in sys.modules if m.startswith('imucalib.readers')])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
