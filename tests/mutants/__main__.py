"""Plant faults into the deciding modules, one at a time, and count those that a test notices.

    python tests/mutants [--count 10] [--seed 0] [--only core loop ...]

A fault is killed when a test of its room fails or does not end within ten times its usual time.
Survivors are printed with their line: each is a test to write, or a fault that changes no number.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from mutants.faults import Fault, faults_of

ROOT = Path(__file__).parents[2]
SOURCE = Path("src/imucalib")
#: Rooms whose code decides a number, and the tests that stand guard over each, quickest first.
ROOMS: dict[str, tuple[str, ...]] = {
    "core": ("tests/oracle", "tests/core", "tests/effects", "tests/estimators/test_nist.py"),
    "effects": ("tests/oracle", "tests/effects"),
    "estimators": ("tests/core", "tests/estimators"),
    "loop": ("tests/loop/test_design.py", "tests/loop/test_evidence.py", "tests/loop"),
    "calibration": ("tests/calibration", "tests/writers", "tests/cli/test_apply.py"),
    "calibrators/lab": ("tests/calibrators/lab",),
    "calibrators/actigraph": ("tests/calibrators/actigraph",),
    "calibrators/array": ("tests/calibrators/array",),
    "rests": ("tests/rests",),
    "recording": ("tests/recording", "tests/readers/csv"),
    "units.py": ("tests/test_units.py", "tests/core"),
}


@dataclass(frozen=True)
class Trial:
    """One fault: killed, or survived; by : seconds that the tests took."""

    room: str
    module: Path
    fault: Fault
    killed: bool
    seconds: float


def drawn(room: str, count: int, rng: np.random.Generator) -> list[tuple[Path, Fault]]:
    """Faults of a room, at random over its modules."""
    at = ROOT / SOURCE / room
    files = [at] if at.is_file() else sorted(at.rglob("*.py"))
    every = [(f, fault) for f in files for fault in faults_of(f.read_text(encoding="utf-8"))]
    picks = rng.permutation(len(every))[:count]
    return [every[k] for k in sorted(picks)]


def tested(tests: Sequence[str], source: Path, limit: float | None) -> bool:
    """Whether the tests pass on the package in a folder."""
    env = {**os.environ, "PYTHONPATH": str(source), "OPENBLAS_NUM_THREADS": "1"}
    here = [t for t in tests if (ROOT / t).exists()]
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-x",
        "-q",
        "-m",
        "not slow",
        "-p",
        "no:cacheprovider",
    ]
    command += ["-p", "no:randomly", *here]
    try:
        run = subprocess.run(
            command, cwd=ROOT, env=env, capture_output=True, timeout=limit, check=False
        )
    except subprocess.TimeoutExpired:
        return False
    return run.returncode == 0


def trials(room: str, count: int, rng: np.random.Generator) -> list[Trial]:
    """Every drawn fault of a room against its tests."""
    out = []
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "src"
        shutil.copytree(ROOT / "src", source, ignore=shutil.ignore_patterns("__pycache__"))
        started = time.monotonic()
        if not tested(ROOMS[room], source, None):
            raise SystemExit(f"{room}: the tests fail without any fault")
        usual = time.monotonic() - started
        for path, fault in drawn(room, count, rng):
            module = path.relative_to(ROOT / "src")
            kept = (source / module).read_text(encoding="utf-8")
            (source / module).write_text(fault.source, encoding="utf-8")
            began = time.monotonic()
            killed = not tested(ROOMS[room], source, 10.0 * usual + 30.0)
            (source / module).write_text(kept, encoding="utf-8")
            out.append(Trial(room, module, fault, killed, time.monotonic() - began))
            word = "killed" if killed else "SURVIVED"
            print(
                f"{word:8s} {module}:{fault.line}: {fault.text[:80]}", file=sys.stderr, flush=True
            )
    return out


def table(found: Sequence[Trial]) -> str:
    """Markdown: killed of planted, room by room, and every survivor."""
    lines = ["| room | planted | killed |", "|---|---|---|"]
    for room in dict.fromkeys(t.room for t in found):
        own = [t for t in found if t.room == room]
        lines.append(f"| {room} | {len(own)} | {sum(t.killed for t in own)} |")
    killed = sum(t.killed for t in found)
    share = 100.0 * killed / max(len(found), 1)
    lines += [f"| all | {len(found)} | {killed} ({share:.0f} %) |", "", "Survivors:", ""]
    lines += [f"- `{t.module}:{t.fault.line}`: `{t.fault.text}`" for t in found if not t.killed]
    return "\n".join(lines)


def main() -> None:
    """Run what is asked for and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10, help="faults of each room")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", choices=list(ROOMS), default=list(ROOMS))
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    print(table([t for room in options.only for t in trials(room, options.count, rng)]))


if __name__ == "__main__":
    main()
