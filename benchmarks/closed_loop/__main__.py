"""The acceptance benchmark of the search for what a model lacks, on worlds that share no code with
it. Prints a Markdown table for each kind:

    python benchmarks/closed_loop bench --count 60 --seed 1 [--jobs 2] [--only two] [--each]

A kind is bench, norm or worn; boards of array_world are run by array_jobs. The same seed gives the
same worlds, and a larger count goes on from a smaller one.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from draws import KINDS, ROWS, drawn, rows
from judge import Judged, judged
from table import table

#: Worlds that a seed has room for.
_ROOM = 100_000


def one(job: tuple[str, str, int]) -> Judged:
    """Make a world and judge what the program does with it."""
    return judged(drawn(*job))


def jobs(kind: str, count: int, seed: int) -> Iterator[tuple[str, str, int]]:
    """Kind, row and seed of every world."""
    for k, row in enumerate(rows(kind, count)):
        yield kind, row, _ROOM * seed + k


def line(j: Judged) -> str:
    """One world, for those who look into a figure of the table."""
    steps = j.told.steps if j.told else ()
    told = "; ".join("/".join(s.names) + " certain" * s.certain for s in steps)
    planted = ", ".join(f"{n} {v:.1f}" for n, v in j.recipe.planted.items()) or j.recipe.slip
    apart = "" if np.isnan(j.response) else f"response {j.over_response:.2f}, "
    return (
        f"{j.recipe.row:8s} {j.recipe.seed} [{planted}] -> {j.told.verdict if j.told else j.code}"
        f" [{told}] {j.slip} over oracle {j.over_oracle:.2f}, {apart}"
        f"base {j.over_base:.2f}, held {j.held}/{j.intervals}, {j.seconds:.1f} s"
    )


def main() -> None:
    """Run what is asked for and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="+", choices=KINDS)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", nargs="*", choices=ROWS, default=list(ROWS), help="rows")
    parser.add_argument("--each", action="store_true", help="tell every world on stderr")
    options = parser.parse_args()
    with ProcessPoolExecutor(options.jobs) as pool:
        for kind in options.kinds:
            asked = [j for j in jobs(kind, options.count, options.seed) if j[1] in options.only]
            found = list[Judged]()
            for j in pool.map(one, asked):
                found.append(j)
                if options.each:
                    print(line(j), file=sys.stderr, flush=True)
            print(f"\n{kind}\n\n{table(found)}", flush=True)


if __name__ == "__main__":
    main()
