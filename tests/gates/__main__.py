"""Write docs/testing.md's list of gates.

python tests/gates
"""

from __future__ import annotations

import ast
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from gates.bounds import Gate, at_most
from testing_page import written

TESTS = Path(__file__).parents[1]


def gates_of(folder: Path) -> dict[str, Gate]:
    """Test -> its gate, wherever `at_most(RUNS, DUE)` stands in a test."""
    found = {}
    for path in sorted(folder.rglob("test_*.py")):
        if path.parent.name == "gates":
            continue
        for test in ast.parse(path.read_text(encoding="utf-8")).body:
            if not isinstance(test, ast.FunctionDef):
                continue
            for node in ast.walk(test):
                if isinstance(node, ast.Call) and ast.unparse(node.func) == "at_most":
                    runs, due = (ast.literal_eval(a) for a in node.args)
                    place = path.relative_to(folder).as_posix()
                    found[f"{place}::{test.name} ({due:g})"] = at_most(runs, due)
    return found


def table() -> str:
    """Markdown: what each gate allows, how often it fails by chance, and which rate it sees."""
    lines = [
        "| test (rate due) | runs | at most | fails by chance | fails in 80 % at a rate of |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| `{name}` | {g.runs} | {g.most} | {100 * g.false_failure:.1f} % | {100 * g.seen:.1f} % |"
        for name, g in gates_of(TESTS).items()
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    written("gates", table())
