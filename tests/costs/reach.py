"""Which functions of the package each test runs, and at what cost: a record of one run.

The package is copied with one statement more in every function, which notes that it was entered.
"""

from __future__ import annotations

import ast
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
#: Stands beside the copied package. A process that a test starts leaves its functions in a file,
#: which the plugin reads when the test has ended.
_NOTES = """\
import atexit, os, sys
entered = set()
def leave():
    with open(os.environ["IMUCAL_ENTERED"], "a") as file:
        file.writelines(name + "\\n" for name in entered)
if "pytest" not in sys.modules and "IMUCAL_ENTERED" in os.environ:
    atexit.register(leave)
"""


@dataclass(frozen=True)
class Reach:
    """tests : function, as `module.py:Class.method` -> the tests that enter it
    seconds : test -> CPU s, its processes' included
    """

    tests: Mapping[str, frozenset[str]]
    seconds: Mapping[str, float]

    def of(self, module: Path, source: str, line: int, around: Sequence[str]) -> list[str]:
        """Tests that run a line of a module, the cheapest first. What stands outside of functions
        is run by all that enter the module's, and seen by the tests below some folders."""
        inside = enclosing(source, line)
        own = f"{module.as_posix()}:"
        names = {f"{own}{inside}"} if inside else {n for n in self.tests if n.startswith(own)}
        found = {test for name in names for test in self.tests.get(name, ())}
        if not inside:
            found |= {test for test in self.seconds if test.startswith(tuple(around))}
        return sorted(found, key=lambda test: self.seconds[test])

    def known_to(self, tests: frozenset[str]) -> Reach:
        """Of these tests alone."""
        seconds = {name: cost for name, cost in self.seconds.items() if name in tests}
        return Reach({name: found & tests for name, found in self.tests.items()}, seconds)


def functions(tree: ast.Module) -> Iterator[tuple[str, ast.FunctionDef]]:
    """Functions that no other function holds, with their names: `Class.method`."""
    todo: list[tuple[str, ast.stmt]] = [("", node) for node in tree.body]
    for within, node in todo:
        if isinstance(node, ast.FunctionDef):
            yield within + node.name, node
        elif isinstance(node, ast.ClassDef):
            todo.extend((f"{within}{node.name}.", inner) for inner in node.body)
        elif isinstance(node, ast.If | ast.Try):
            todo.extend((within, inner) for inner in node.body)


def enclosing(source: str, line: int) -> str:
    """The function that holds a line, "" outside of functions. A default of an argument is
    outside: it is evaluated once."""
    for name, node in functions(ast.parse(source)):
        if node.body[0].lineno <= line <= (node.end_lineno or 0):
            return name
    return ""


def _noted(tree: ast.AST, name: str) -> None:
    """Every function and lambda of a tree notes a name: one that is made here may run elsewhere."""
    note = f"_entered.add({name!r})"
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            at = 0 if ast.get_docstring(node) is None else 1
            node.body[at:at] = ast.parse(note).body
        elif isinstance(node, ast.Lambda):
            both = ast.Tuple([ast.parse(note, mode="eval").body, node.body], ast.Load())
            node.body = ast.Subscript(both, ast.Constant(1), ast.Load())


def noting(source: str, module: str) -> str:
    """A module whose functions note that they were entered."""
    tree = ast.parse(source)
    for name, node in functions(tree):
        _noted(node, f"{module}:{name}")
    for node in tree.body:
        if not isinstance(node, ast.FunctionDef | ast.ClassDef):
            _noted(node, f"{module}:lambda")
    after = 0
    for k, node in enumerate(tree.body):
        words = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if words or (isinstance(node, ast.ImportFrom) and node.module == "__future__"):
            after = k + 1
    tree.body[after:after] = ast.parse("from entered_functions import entered as _entered").body
    return ast.unparse(ast.fix_missing_locations(tree))


def noted_copy(folder: Path) -> Path:
    """The package in a folder, with notes; what to put on the path."""
    source = folder / "src"
    shutil.copytree(ROOT / "src", source, ignore=shutil.ignore_patterns("__pycache__"))
    for path in source.rglob("*.py"):
        module = path.relative_to(source).as_posix()
        path.write_text(noting(path.read_text(encoding="utf-8"), module), encoding="utf-8")
    (source / "entered_functions.py").write_text(_NOTES, encoding="utf-8")
    return source


def record(into: Path, tier: str) -> None:
    """Run the tests of a tier (pytest's -m) on a noted copy, in one process; a line of JSON a test
    goes to a file."""
    with tempfile.TemporaryDirectory() as folder:
        source = noted_copy(Path(folder))
        env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(source), str(ROOT / "tests")]),
               "OPENBLAS_NUM_THREADS": "1", "IMUCAL_ENTERED": str(Path(folder) / "entered"),
               "IMUCAL_REACH": str(into.resolve())}  # fmt: skip
        words = ["-p", "costs.entering", "-p", "no:cacheprovider", "-m", tier, "-q", "-rsfE"]
        subprocess.run([sys.executable, "-m", "pytest", *words], cwd=ROOT, env=env, check=False)


def collected(tier: str) -> frozenset[str]:
    """Names of the tests of a tier that there are."""
    call = [sys.executable, "-m", "pytest", "--collect-only", "-m", tier]
    env = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
    said = subprocess.run(call, cwd=ROOT, env=env, capture_output=True, text=True, check=True)
    return frozenset(line for line in said.stdout.splitlines() if "::" in line)


def read(paths: Sequence[Path]) -> Reach:
    """What `record` wrote, the later file's word where two know a test. Tests that failed without
    any fault tell nothing."""
    lines = (row for p in paths for row in p.read_text(encoding="utf-8").splitlines())
    rows = {row["test"]: row for row in map(json.loads, lines) if row["passed"]}
    tests: dict[str, set[str]] = {}
    seconds = {name: row["seconds"] for name, row in rows.items()}
    for test, row in rows.items():
        for name in row["entered"]:
            tests.setdefault(name, set()).add(test)
    return Reach({name: frozenset(found) for name, found in tests.items()}, seconds)
