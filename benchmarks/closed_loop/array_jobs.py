"""The acceptance benchmark of the array's loop, on logs that its own simulation makes:

    python benchmarks/closed_loop/array_jobs.py [--scale 1] [--jobs 2] [--scenarios clean ...]

Seeds do not depend on the scenarios that are asked for.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from itertools import count
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import array_world
import numpy as np
from array_table import table
from trial import Job

_FIRST = 3_000_000
Recipe = dict[str, Any]


def jobs(scale: float) -> Iterator[Job]:
    """All trials; `scale` multiplies their number (1 is the full benchmark)."""
    seeds = count(_FIRST)
    for scenario, number, recipes in _recipes():
        for recipe in recipes:
            for _ in range(max(1, round(number * scale))):
                yield Job("array", scenario, next(seeds), **recipe)


def _recipes() -> Iterator[tuple[str, int, list[Recipe]]]:
    """Scenario, trials of each recipe at scale 1, and the recipes."""
    of = array_world
    names = of.effects()
    yield "clean", 400, [{}]
    for kind in of.NOISE:
        yield f"noise: {kind}", 100, [{"noise": kind}]
    single: list[Recipe] = [{"effects": ((n, size),)} for n in names for size in of.sizes(n)]
    yield "one effect", 300 // len(single) + 3, single
    draw = np.random.default_rng(5)
    pairs = [draw.choice(len(names), 2, replace=False) for _ in range(40)]
    yield "two effects", 3, [{"effects": tuple((names[k], 1.0) for k in pair)} for pair in pairs]
    for size, words in ((1.0, "weak"), (3.0, "strong")):
        yield f"outside, {words}", 30, [{"outside": (name, size)} for name in of.OUTSIDE]
    yield "confounded", 40, [{"effects": ((n, size),)} for n, _, size in of.CONFOUNDED]


def main() -> None:
    """Run what is asked for and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scale", type=float, default=1.0)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--scenarios", nargs="*", default=[""], help="beginnings of their names")
    options = parser.parse_args()
    asked = [j for j in jobs(options.scale) if j.scenario.startswith(tuple(options.scenarios))]
    found = []
    with ProcessPoolExecutor(options.jobs) as pool:
        for n, trial in enumerate(pool.map(array_world.trial, asked, chunksize=4), 1):
            found.append(trial)
            if n % 50 == 0 or n == len(asked):
                print(f"{n} of {len(asked)}", file=sys.stderr, flush=True)
    print(table(found))


if __name__ == "__main__":
    main()
