"""Plant faults into the deciding modules, one at a time, and count those that a test notices.

    python tests/mutants [--count 10] [--seed 0] [--only core loop ...] [--page]

A fault is killed when a test of its room fails or does not end within ten times its usual time.
Survivors are printed with their line: each is a test to write, or a fault that changes no number:
then `harmless.txt` says why.
"""

from __future__ import annotations

import argparse
import os
import pickle
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from mutants.faults import Fault, faults_of
from testing_page import written

ROOT = Path(__file__).parents[2]
SOURCE = Path("src/imucalib")
OPTIONS = "tests/options/test_each.py"


@dataclass(frozen=True)
class Guard:
    """Tests that stand guard over a room, quickest first. only : pytest's -k, of OPTIONS alone;
    slow : whether those of the slow tier are run too"""

    tests: tuple[str, ...]
    only: str = ""
    slow: bool = False


#: Rooms whose code decides a number.
ROOMS: dict[str, Guard] = {
    "units.py": Guard(("tests/test_units.py", "tests/core")),
    "core": Guard(
        (
            "tests/oracle",
            "tests/core",
            "tests/goldens",
            "tests/effects",
            "tests/estimators/test_nist.py",
        )
    ),
    "effects": Guard(("tests/oracle", "tests/effects")),
    "rests": Guard(("tests/rests",)),
    "recording": Guard(("tests/recording", "tests/readers/csv"), "convert"),
    "estimators": Guard(
        ("tests/estimators/test_nist.py", "tests/estimators", "tests/core"), "array and motion"
    ),
    "loop": Guard(("tests/goldens", "tests/loop"), "lab and (only or seed or auto)"),
    "calibration": Guard(
        ("tests/calibration", "tests/goldens"), "apply or export or (output and not array)"
    ),
    "calibrators/lab/conventions.py": Guard(("tests/calibrators/lab/test_conventions.py",), "lab"),
    "calibrators/lab": Guard(
        ("tests/calibrators/lab", "tests/cli/test_simulate.py"), "lab and not simulate"
    ),
    "calibrators/actigraph": Guard(("tests/calibrators/actigraph",), "actigraph"),
    "calibrators/array": Guard(("tests/calibrators/array",), "array and not simulate"),
}
HARMLESS = Path(__file__).with_name("harmless.txt")


@dataclass(frozen=True)
class Trial:
    """One fault: killed, or survived. line : the source at it; harmless : why it changes no number,
    where that is known; seconds : that the tests took"""

    room: str
    module: Path
    fault: Fault
    line: str
    killed: bool
    harmless: str
    seconds: float

    @property
    def key(self) -> tuple[str, ...]:
        """As `harmless` knows it."""
        return self.module.as_posix(), self.line, self.fault.text

    @property
    def words(self) -> str:
        """`what is changed` in its line."""
        return f"`{self.module.as_posix()}`: `{self.fault.text}` in `{self.line}`"


def harmless() -> dict[tuple[str, ...], str]:
    """(module, line, what is changed) of faults that change no number -> why, judged by eye."""
    lines = HARMLESS.read_text(encoding="utf-8").splitlines()
    rows = (line.split(" | ") for line in lines if line and not line.startswith("#"))
    return {tuple(what): why for *what, why in rows}


def drawn(room: str, count: int, rng: np.random.Generator) -> list[tuple[Path, Fault]]:
    """Faults of a room, at random over its modules."""
    at = ROOT / SOURCE / room
    files = [at] if at.is_file() else sorted(at.rglob("*.py"))
    every = [(f, fault) for f in files for fault in faults_of(f.read_text(encoding="utf-8"))]
    picks = rng.permutation(len(every))[:count]
    return [every[k] for k in sorted(picks)]


def tested(guard: Guard, source: Path, limit: float | None) -> bool:
    """Whether the tests pass on the package in a folder."""
    env = {**os.environ, "PYTHONPATH": str(source), "OPENBLAS_NUM_THREADS": "1"}
    tier = "" if guard.slow else "not slow"
    pytest = [sys.executable, "-m", "pytest", "-x", "-q", "-m", tier, "-p", "no:cacheprovider"]
    calls = [[*pytest, OPTIONS, "-k", guard.only]] if guard.only else []
    calls.append([*pytest, *(t for t in guard.tests if (ROOT / t).exists())])
    try:
        return all(
            subprocess.run(
                call, cwd=ROOT, env=env, capture_output=True, timeout=limit, check=False
            ).returncode
            == 0
            for call in calls
        )
    except subprocess.TimeoutExpired:
        return False


def trials(room: str, count: int, rng: np.random.Generator) -> list[Trial]:
    """Every drawn fault of a room against its tests."""
    out, known = [], harmless()
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
            line = kept.splitlines()[fault.line - 1].strip()
            why = known.get((module.as_posix(), line, fault.text), "")
            spent = time.monotonic() - began
            out.append(Trial(room, module, fault, line, killed, why, spent))
            word = "killed" if killed else "harmless" if why else "SURVIVED"
            print(f"{word:8s} {module}:{fault.line}: {fault.text}", file=sys.stderr, flush=True)
    return out


def table(found: Sequence[Trial]) -> str:
    """Markdown: killed of those that change a number, room by room, and every survivor."""
    head = "| room | planted | harmless | killed of the others |"
    lines = [head, "|---|---|---|---|"]
    for room in [*dict.fromkeys(t.room for t in found), "all"]:
        own = [t for t in found if room in (t.room, "all")]
        real = [t for t in own if t.killed or not t.harmless]
        killed = sum(t.killed for t in real)
        share = 100.0 * killed / max(len(real), 1)
        lines.append(
            f"| {room} | {len(own)} | {len(own) - len(real)} | {killed} of {len(real)} "
            f"({share:.0f} %) |"
        )
    left = [t for t in found if not t.killed]
    lines += ["", "Survivors that change a number:", ""]
    lines += [f"- {t.words}" for t in left if not t.harmless] or ["- none"]
    lines += ["", "Survivors that change none:", ""]
    lines += [f"- {t.words}: {t.harmless}" for t in left if t.harmless] or ["- none"]
    return "\n".join(lines)


def main() -> None:
    """Run what is asked for and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10, help="faults of each room")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", choices=list(ROOMS), default=list(ROOMS))
    parser.add_argument("--save", type=Path, help="keep the trials for --page")
    parser.add_argument(
        "--page",
        nargs="*",
        type=Path,
        metavar="FILE",
        help="write docs/testing.md's table, of the FILEs that --save kept",
    )
    options = parser.parse_args()
    found: list[Trial] = []
    for path in options.page or ():
        found += pickle.loads(path.read_bytes())
    for room in () if found else options.only:
        rng = np.random.default_rng([options.seed, list(ROOMS).index(room)])
        found += trials(room, options.count, rng)
        if options.save:
            options.save.write_bytes(pickle.dumps(found))
    known = harmless()
    found = [replace(t, harmless=known.get(t.key, "")) for t in found]
    print(table(found))
    if options.page is not None:
        line = f"{date.today()}, `python tests/mutants --count {options.count} "
        some = "" if options.only == list(ROOMS) else f" --only {' '.join(options.only)}"
        line += f"--seed {options.seed}{some}`:\n\n"
        written("mutants", line + table(found))


if __name__ == "__main__":
    main()
