"""Measure every test, decide the tiers, and write docs/testing.md's tables of costs.

python tests/costs [--fast]       --fast: the fast tier alone, tiers stay as they are
python tests/costs --from FILE    a file of `costs.measuring` instead of a run
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from costs.tiers import LIST, chosen, rooms, slow_tier
from testing_page import written

ROOT = Path(__file__).parents[2]


def measured(fast: bool) -> dict[str, float]:
    """Name -> CPU s of a run in one process."""
    with tempfile.TemporaryDirectory() as folder:
        costs = Path(folder) / "costs.tsv"
        path = os.pathsep.join([str(ROOT / "tests"), os.environ.get("PYTHONPATH", "")])
        env = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "IMUCAL_COSTS": str(costs),
               "PYTHONPATH": path}  # fmt: skip
        words = ["-p", "costs.measuring", "-m", "not slow" if fast else "", "-q"]
        subprocess.run([sys.executable, "-m", "pytest", *words], cwd=ROOT, env=env, check=False)
        return read(costs)


def read(path: Path) -> dict[str, float]:
    """Name -> CPU s of a file of `costs.measuring`."""
    rows = (line.split("\t") for line in path.read_text(encoding="utf-8").splitlines())
    return {name.removeprefix("tests/"): float(cost) for cost, name in rows}


def tables(costs: Mapping[str, float]) -> str:
    """Markdown: CPU s of both tiers by room, and the twenty that cost most in the fast one."""
    slow = slow_tier()
    fast = {name: cost for name, cost in costs.items() if name not in slow}
    rest = {name: cost for name, cost in costs.items() if name in slow}
    lines = ["| room | tests | CPU s | slow tests | CPU s |", "|---|---|---|---|---|"]
    of_rest = rooms(rest)
    for room, (count, cost) in rooms(fast).items():
        other = of_rest.get(room, (0, 0.0))
        lines.append(f"| {room} | {count} | {cost:.0f} | {other[0]} | {other[1]:.0f} |")
    lines.append(
        f"| all | {len(fast)} | {sum(fast.values()):.0f} | {len(rest)} | {sum(rest.values()):.0f} |"
    )
    lines += ["", "The twenty that cost most of `make test`:", "", "| test | CPU s |", "|---|---|"]
    most = sorted(fast, key=lambda name: -fast[name])[:20]
    return "\n".join([*lines, *(f"| `{name}` | {fast[name]:.1f} |" for name in most)])


def main() -> None:
    """Run, decide, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fast", action="store_true")
    parser.add_argument("--from", dest="file", type=Path)
    options = parser.parse_args()
    costs = read(options.file) if options.file else measured(options.fast)
    if not options.fast:
        head = "# Tests of more than 0.6 CPU s, by `python tests/costs`: of `make test-slow`.\n"
        LIST.write_text(head + "\n".join(chosen(costs)) + "\n", encoding="utf-8")
    written("costs", tables(costs))


if __name__ == "__main__":
    main()
