"""Looking again at a growing table: the e-value of a `lab` step against its p.

Benches in plain numpy (`tests/worlds/plain_bench.py`), searched after every four positions. Usage:

    python benchmarks/growing.py [--runs 400] [--powers 100] [--jobs 1]
"""

from __future__ import annotations

import argparse
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import numpy as np

from imucalib.calibrators.lab.bench import position_observations
from imucalib.calibrators.lab.calibrate import LabSettings, base_model
from imucalib.calibrators.lab.conventions import Conventions
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.core.observations import Observations
from imucalib.effects import catalogue, families
from imucalib.estimators.least_squares import fit
from imucalib.loop.anytime.e_value import e_value
from imucalib.loop.candidates import effect_candidates
from imucalib.loop.evidence import score
from imucalib.units import MG, STANDARD_GRAVITY
from worlds.plain_bench import Bench, Plan

ROWS, FIRST, STEP = 36, 16, 4


def observed(bench: Bench) -> Observations:
    """The bench's sheet, as `lab` reads it."""
    c = bench.conditions
    columns = {
        "inclination": c.inclination, "tool_face": c.tool_face, "temperature": c.temperature,
    }  # fmt: skip
    table = PositionTable(columns, {}, {}, np.arange(ROWS), "", "")
    return position_observations(table, bench.reading * MG, Conventions(), STANDARD_GRAVITY)


def looked(data: Observations, draws: int, seed: int) -> tuple[float, float]:
    """The e-value that something is missing, and the smallest family-wise p."""
    found = fit(base_model(LabSettings(), data), data)
    singles, _ = effect_candidates(found, list(catalogue().values()))
    scores = score(found, singles, np.random.default_rng(seed), draws=draws)
    live = [s.candidate.columns for s in scores if not s.absorbed]
    p = min(s.p for s in scores) if draws else 1.0
    return e_value(found, live, len(live) + len(families())), p


def clean(seed: int) -> float:
    """Largest e-value over looks at a bench that lacks nothing."""
    data = observed(Bench(Plan(seed, n=ROWS)))
    return max(looked(data.take(np.arange(n)), 0, seed)[0] for n in range(FIRST, ROWS + 1, STEP))


def planted(job: tuple[int, str, float]) -> tuple[float, float]:
    """e and p of one look at the whole table."""
    seed, name, size = job
    return looked(observed(Bench(Plan(seed, ((name, size),), n=ROWS))), 199, seed)


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=400)
    parser.add_argument("--powers", type=int, default=60)
    parser.add_argument("--jobs", type=int, default=1)
    chosen = parser.parse_args()
    with ProcessPoolExecutor(chosen.jobs) as pool:
        largest = np.array(list(pool.map(clean, range(chosen.runs), chunksize=8)))
        print(f"{chosen.runs} clean benches, looks at {FIRST} to {ROWS} rows: e >= 20 ever in "
              f"{100 * np.mean(largest >= 20):.1f} %, largest {largest.max():.2g}",
              flush=True)  # fmt: skip
        print("\n| planted | λ | p <= 5 % at one look | e >= 20 |")
        print("|---|---|---|---|")
        for name in ("quadratic", "inclination_zero"):
            for size in (5.0, 6.0, 7.0, 8.0):
                jobs = [(5000 + k, name, size) for k in range(chosen.powers)]
                e, p = np.array(list(pool.map(planted, jobs, chunksize=4))).T
                print(f"| {name} | {size:g} | {100 * np.mean(p <= 0.05):.0f} % | "
                      f"{100 * np.mean(e >= 20):.0f} % |", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
