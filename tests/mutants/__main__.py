"""Plant faults into the deciding modules, one at a time, and count those that a test notices.

    python tests/mutants --reach FILE [--count 10] [--seed 0] [--only core loop ...] [--page]

Which tests can notice a fault is measured once (`reach`: a run of the tests, kept in FILE). A fault
is killed when one of those that run its line fails, or does not end; they are tried from the
cheapest on, up to `--budget` CPU s. Survivors are printed with their line: each is a test to write,
or a fault that changes no number: then `harmless.txt` says why.
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
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from datetime import date
from itertools import pairwise
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from costs.reach import Reach, collected, read, record
from mutants.faults import Fault, fault, places
from testing_page import written

ROOT = Path(__file__).parents[2]
SOURCE = Path("src/imucalib")
#: Rooms whose code decides a number, with the tests that look at what stands outside of functions
#: there (constants, catalogues), beside those that enter the module's.
ROOMS: dict[str, tuple[str, ...]] = {
    "units.py": ("tests/test_units.py",),
    "core": ("tests/core",),
    "effects": ("tests/oracle", "tests/effects"),
    "rests": ("tests/rests",),
    "recording": ("tests/recording",),
    "estimators": ("tests/estimators",),
    "loop": ("tests/loop", "tests/goldens"),
    "calibration": ("tests/calibration",),
    "calibrators/lab": ("tests/calibrators/lab",),
    "calibrators/actigraph": ("tests/calibrators/actigraph",),
    "calibrators/array": ("tests/calibrators/array",),
}
#: Share of the budget that is spent in one run of pytest: most faults are killed by the first.
STAGES = (0.1, 0.9)
_LIMITED = """\
import resource, sys, pytest
resource.setrlimit(resource.RLIMIT_CPU, (int(sys.argv[1]),) * 2)
sys.exit(pytest.main(sys.argv[2:]))
"""
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
    # A line of source may hold the mark.
    return {(module, " | ".join(rest), what): why for module, *rest, what, why in rows}


def drawn(room: str, count: int, rng: np.random.Generator) -> list[tuple[Path, Fault]]:
    """Faults of a room, at random over its modules."""
    at = ROOT / SOURCE / room
    files = [at] if at.is_file() else sorted(at.rglob("*.py"))
    texts = {f: f.read_text(encoding="utf-8") for f in files}
    every = [(f, number) for f, text in texts.items() for number in places(text)]
    picks = sorted(rng.permutation(len(every))[:count])
    return [(f, fault(texts[f], number)) for f, number in (every[k] for k in picks)]


def staged(tests: Sequence[str], reach: Reach, budget: float) -> Iterator[list[str]]:
    """Tests in stages, the cheapest first, as far as a budget (CPU s) goes."""
    spent = np.cumsum([reach.seconds[t] for t in tests])
    ends = np.searchsorted(spent, budget * np.cumsum(STAGES), side="right")
    for start, end in pairwise([0, *ends]):
        if end > start:
            yield list(tests[start:end])


def passes(tests: Sequence[str], source: Path, limit: int) -> bool:
    """Whether tests pass on the package in a folder, each process within a CPU time (s): a busy
    machine ends none."""
    env = {**os.environ, "PYTHONPATH": str(source), "OPENBLAS_NUM_THREADS": "1"}
    listed = source.parent / "tests.txt"
    listed.write_text("\n".join(tests), encoding="utf-8")
    call = [sys.executable, "-c", _LIMITED, str(limit), "-x", "-m", "", "-p", "no:cacheprovider"]
    try:
        done = subprocess.run(
            [*call, f"@{listed}"], cwd=ROOT, env=env, capture_output=True, timeout=60.0 * limit,
            check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def trial(room: str, path: Path, planted: Fault, reach: Reach, budget: float) -> Trial:
    """One fault against the tests that run its line."""
    module = path.relative_to(ROOT / "src")
    kept = path.read_text(encoding="utf-8")
    began = time.monotonic()
    tests = reach.of(module, kept, planted.line, ROOMS[room])
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "src"
        shutil.copytree(ROOT / "src", source, ignore=shutil.ignore_patterns("__pycache__"))
        (source / module).write_text(planted.source, encoding="utf-8")
        stages = staged(tests, reach, budget)
        killed = not all(passes(stage, source, round(60.0 + 5.0 * budget)) for stage in stages)
    line = kept.splitlines()[planted.line - 1].strip()
    why = harmless().get((module.as_posix(), line, planted.text), "")
    spent = time.monotonic() - began
    word = "killed" if killed else "harmless" if why else "SURVIVED"
    place = f"{module}:{planted.line}: {planted.text}"
    print(f"{word:8s} {place} ({len(tests)} tests, {spent:.0f} s)", file=sys.stderr, flush=True)
    return Trial(room, module, planted, line, killed, why, spent)


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


def asked() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10, help="faults of each room")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", choices=list(ROOMS), default=list(ROOMS))
    parser.add_argument("--reach", type=Path, nargs="+", help="measured where there is none")
    parser.add_argument("--tier", default="", help="pytest's -m, of the tests to measure and try")
    parser.add_argument("--budget", type=float, default=200.0, help="CPU s of tests a fault")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--save", type=Path, help="keep the trials for --page")
    parser.add_argument(
        "--page",
        nargs="*",
        type=Path,
        metavar="FILE",
        help="write docs/testing.md's table, of the FILEs that --save kept",
    )
    return parser.parse_args()


def trials(options: argparse.Namespace) -> list[Trial]:
    """Every fault that is asked for."""
    for path in options.reach:
        if not path.exists():
            record(path, options.tier)
    reach = read(options.reach).known_to(collected(options.tier))
    todo = []
    for room in options.only:
        rng = np.random.default_rng([options.seed, list(ROOMS).index(room)])
        todo += [(room, *one) for one in drawn(room, options.count, rng)]
    with ThreadPoolExecutor(options.jobs) as pool:
        found = list(pool.map(lambda one: trial(*one, reach, options.budget), todo))
    if options.save:
        options.save.write_bytes(pickle.dumps(found))
    return found


def main() -> None:
    """Run what is asked for and print the table."""
    options = asked()
    found = [t for path in options.page or () for t in pickle.loads(path.read_bytes())]
    found = found or trials(options)
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
