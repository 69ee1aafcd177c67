"""How cost grows with the work: python benchmarks/growth.py [--only NAME].

Each case is a command on three sizes, each twice the one before, as processes of their own. Its
exponent is log2 of the ratio of the two differences in CPU seconds, so what every run costs
(imports, reports) takes no part.
"""

from __future__ import annotations

import argparse
import math
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

RUNS = 2  # of each size, the cheaper one counts


@dataclass(frozen=True)
class Case:
    """name : what doubles; size : the smallest; made : writes files into a folder for a size, and
    returns the command that is measured"""

    name: str
    size: int
    made: Callable[[Path, int], list[str]]


def imucal(*words: object) -> None:
    """A command that only prepares."""
    command = [sys.executable, "-m", "imucalib", *map(str, words)]
    subprocess.run(command, check=True, capture_output=True)


def cpu(words: list[str]) -> tuple[float, int]:
    """CPU s of a command and its exit code."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-m", "imucalib", *words], capture_output=True, check=False
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return spent, done.returncode


def bench_rows(folder: Path, size: int) -> list[str]:
    imucal("simulate", "lab", folder / "t.csv", "--positions", size, "--layout", "random")
    return ["lab", str(folder / "t.csv"), "-q"]


def worn_days(folder: Path, size: int) -> list[str]:
    """More posture runs, and more samples with them."""
    imucal("simulate", "actigraph", folder / "w.h5", "--days", size, "--rate", 25)
    return ["actigraph", str(folder / "w.h5"), "-q"]


def worn_rate(folder: Path, size: int) -> list[str]:
    """More samples of the same day."""
    imucal("simulate", "actigraph", folder / "w.h5", "--days", 2, "--rate", size)
    return ["actigraph", str(folder / "w.h5"), "-q", "--no-loop"]


def turns(folder: Path, size: int) -> list[str]:
    imucal("simulate", "imu", folder / "t.mcap", "--rests", size)
    return ["imu", str(folder / "t.mcap"), "-q"]


def board_imus(folder: Path, size: int) -> list[str]:
    """An array of more IMUs, without the search, whose candidates are each IMU's own."""
    return board(folder, size, 60.0, "--no-loop")


def board_seconds(folder: Path, size: int) -> list[str]:
    return board(folder, 8, float(size))


def board(folder: Path, imus: int, seconds: float, *more: str) -> list[str]:
    places = "".join(
        f"  - {{name: imu{k}, position: [{8 * (k % 6)}, {8 * (k // 6)}, {4 * (k % 3)}]}}\n"
        for k in range(imus)
    )
    (folder / "board.yaml").write_text(f"name: grid\nimus:\n{places}")
    given = ["--board", str(folder / "board.yaml")]
    imucal("simulate", "array", folder / "a.h5", *given, "--seconds", seconds)
    return ["array", str(folder / "a.h5"), *given, "-q", *more]


def devices(folder: Path, size: int) -> list[str]:
    files = [folder / f"{k}.csv" for k in range(size)]
    for k, file in enumerate(files):
        imucal("simulate", "lab", file, "--positions", 24, "--seed", k)
    return ["fleet", *map(str, files), "-q", "-o", str(folder / "fleet"), "--force"]


def applied(folder: Path, size: int) -> list[str]:
    imucal("simulate", "actigraph", folder / "w.h5", "--days", 1, "--rate", 25)
    run = [
        sys.executable,
        "-m",
        "imucalib",
        "actigraph",
        str(folder / "w.h5"),
        "-q",
        "-o",
        str(folder),
    ]
    subprocess.run(run, check=False, capture_output=True)
    imucal("simulate", "actigraph", folder / "x.h5", "--days", size, "--rate", 25)
    made = [str(folder / "calibration.yaml"), str(folder / "x.h5"), "-o", str(folder / "y.h5")]
    return ["apply", *made, "-q", "--force"]


CASES = (
    Case("rows of a bench", 250, bench_rows),
    Case("days worn", 4, worn_days),
    Case("samples of a day", 50, worn_rate),
    Case("turns of an IMU", 60, turns),
    Case("IMUs of an array, no search", 8, board_imus),
    Case("seconds of an array", 60, board_seconds),
    Case("devices of a fleet", 5, devices),
    Case("days that are corrected", 4, applied),
)


def measured(case: Case) -> str:
    """A row of the table."""
    spent = []
    for size in (case.size, 2 * case.size, 4 * case.size):
        with tempfile.TemporaryDirectory() as name:
            words = case.made(Path(name), size)
            runs = [cpu(words) for _ in range(RUNS)]
        if any(code not in (0, 5) for _, code in runs):
            return f"| {case.name} | exit {runs[0][1]} at {size} | | |"
        spent.append(min(seconds for seconds, _ in runs))
    first, second = spent[1] - spent[0], spent[2] - spent[1]
    exponent = math.log2(second / first) if first > 0.0 and second > 0.0 else math.nan
    sizes = ", ".join(str(case.size * factor) for factor in (1, 2, 4))
    return f"| {case.name} | {sizes} | {', '.join(f'{s:.2f}' for s in spent)} | {exponent:.2f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", help="cases whose name has these words")
    only = parser.parse_args().only
    print("| what doubles | sizes | CPU s | exponent |\n|---|---|---|---|")
    for case in CASES:
        if not only or only in case.name:
            print(measured(case), flush=True)


if __name__ == "__main__":
    main()
