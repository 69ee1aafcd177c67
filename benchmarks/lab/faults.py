"""Slips of hand in a bench's sheet: found, with the right line to paste; clean sheets left alone.

The sheets are plain numpy (tests/worlds/sheets.py), with one effect of the catalogue or none,
normal, heavy-tailed or correlated noise, settings that scatter by 0 to 0.3 deg. Found: the first
line, or a rival that is named beside it, is the one that undoes the slip; settled: after pasting it
nothing is said any more. Usage:

    python benchmarks/lab/faults.py [--benches 60] [--clean 200] [--jobs 2] [--table-step 1]

Then the paper's Table 1, its misprint repaired: each of its 496 exchanges, and each of its angles
mistyped by 5, 10 and 60 deg (`--table-step 5` takes every fifth).
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))

import numpy as np

from imucalib.calibrators.lab.position_table import read_position_table
from imucalib.calibrators.lab.run import run_lab
from imucalib.cli.lab import command, request_of
from imucalib.errors import ImucalError
from worlds import sheets

TABLE_1 = Path(__file__).parents[2] / "sample_logs" / "paper_table_1.csv"


@dataclass(frozen=True)
class Told:
    """What was said of one sheet: sentences, and the line of each slip with its rivals."""

    text: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]
    seconds: float


def told(path: Path, line: str = "") -> Told:
    """What `imucal lab` asks about a sheet, records that stand alone included."""
    context = command.make_context("lab", [str(path), *shlex.split(line)])
    with context:
        request = request_of(context.params)
    start = time.process_time()
    try:
        run = run_lab(read_position_table(path), request)
    except ImucalError as error:
        return Told((str(error),), (), time.process_time() - start)
    lines = tuple((f.line, *f.rivals) for f in run.faults.slips)
    return Told(run.outcome.undecided, lines, time.process_time() - start)


@dataclass(frozen=True)
class Verdict:
    """found : the right line stands there; first : before its rivals; alone : and nothing else is
    claimed; settled : pasting it ends the matter"""

    found: bool
    first: bool
    alone: bool
    settled: bool
    seconds: float
    words: str


def one(job: tuple[str, int]) -> Verdict:
    """Plant a slip of a kind, and see."""
    kind, seed = job
    rng = np.random.default_rng(seed)
    ordered = kind in ("move", "shift", "late", "setting", "part")
    names = sheets.LAYOUTS[:2] if ordered else sheets.LAYOUTS
    sheet = sheets.bench(
        seed,
        name=names[seed % len(names)],
        effect=str(rng.choice(sheets.EFFECTS)),
        noise=str(rng.choice(sheets.NOISES)),
        scatter=float(rng.choice([0.0, 0.1, 0.2, 0.3])),
    )
    return judged(kind, seed, sheet if kind == "clean" else sheets.slipped(sheet, kind, rng))


def judged(kind: str, seed: int, sheet: sheets.Sheet) -> Verdict:
    """What is said of a sheet beside what was planted."""
    with tempfile.TemporaryDirectory() as folder:
        path = sheet.write(Path(folder) / "sheet.csv")
        said = told(path)
        words = f"{kind} {seed}: {sheet.slip.line} | {' || '.join(said.text)[:300]}"
        if kind == "clean":
            return Verdict(not said.text, True, True, True, said.seconds, words)
        line = sheet.slip.line
        found = any(line in text for text in said.text)
        first = (said.lines[0][0] == line) if said.lines else found
        after = told(path, line).text if found else ("not found",)
    return Verdict(
        found, first, len(said.text) == 1, not after, said.seconds, words + f" -> {after}"
    )


def on_the_table(job: tuple[str, int]) -> Verdict:
    """One slip in the paper's Table 1, by its number."""
    kind, number = job
    printed = np.genfromtxt(TABLE_1, delimiter=",", skip_header=3)
    reading = printed[:, 2:] / 1000.0
    reading[9, 1] *= -1.0
    sheet = sheets.Sheet(printed[:, 0], printed[:, 1], reading)
    if kind == "exchange":
        p, q = (int(r[number]) + 1 for r in np.triu_indices(len(reading), 1))
        return judged(kind, number, sheets.exchanged(sheet, p, q))
    row, rest = divmod(number, 6)
    column = ("inclination", "tool_face")[rest % 2]
    by = (5.0, 10.0, 60.0)[rest // 2]
    return judged(kind, number, sheets.mistyped(sheet, row + 1, column, by))


def table_1(step: int, pool: ProcessPoolExecutor) -> None:
    """Exchanges and mistyped angles of Table 1; at row 10 the tool stands upright, no tool-face."""
    typed = [k for k in range(32 * 6) if not (k // 6 == 9 and k % 2)]
    for kind, numbers in (("exchange", list(range(496))), ("angle", typed)):
        made = list(pool.map(on_the_table, [(kind, k) for k in numbers[::step]]))
        shown(f"Table 1, {kind}", made)


def shown(name: str, made: list[Verdict]) -> None:
    """One line of the table, and every miss to stderr."""
    parts = [str(sum(getattr(v, n) for v in made)) for n in ("found", "first", "alone", "settled")]
    if name == "clean":
        name, parts[1:] = "none (found: nothing said)", ["-"] * 3
    cpu = np.median([v.seconds for v in made])
    print(f"| {name} | {len(made)} | {' | '.join(parts)} | {cpu:.2f} |", flush=True)
    for v in made:
        if not (v.found and v.alone and v.settled):
            print(v.words, file=sys.stderr)


def main() -> None:
    """One Markdown table, and every miss to stderr."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--benches", type=int, default=60)
    parser.add_argument("--clean", type=int, default=200)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--table-step", type=int, default=1)
    options = parser.parse_args()
    print("| slip | sheets | found | first | nothing else | settled | CPU s, median |")
    print("|---|---|---|---|---|---|---|")
    with ProcessPoolExecutor(options.jobs) as pool:
        for kind in ("clean", *sheets.KINDS):
            count = options.clean if kind == "clean" else options.benches
            made = list(pool.map(one, [(kind, 5000 + k) for k in range(count)]))
            shown(kind, made)
        table_1(options.table_step, pool)


if __name__ == "__main__":
    main()
