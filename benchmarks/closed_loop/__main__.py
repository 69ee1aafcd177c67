"""The acceptance benchmark of the closed loop. Prints one Markdown table a calibrator:

    python benchmarks/closed_loop [--scale 1] [--jobs 2] [--only lab ...] [--keep FOLDER]

Trials are kept in FOLDER as one JSON line each, so that a run that was stopped goes on.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from scenarios import WORLDS, jobs, world
from table import table
from trial import Job, Trial


def one(job: Job) -> Trial:
    """Run a job in whatever process this is."""
    run: Callable[[Job], Trial] = world(job.calibrator).trial
    return run(job)


def kept(path: Path) -> dict[int, Trial]:
    """Trials that are already there, by seed."""
    found: dict[int, Trial] = {}
    if path.is_file():
        for line in path.read_text().splitlines():
            trial = _thawed(json.loads(line))
            found[trial.job.seed] = trial
    return found


def _thawed(values: dict[str, object]) -> Trial:
    def tuples(value: object) -> object:
        return tuple(tuples(v) for v in value) if isinstance(value, list) else value

    plain = {name: tuples(value) for name, value in values.items()}
    job = values["job"]
    assert isinstance(job, dict)
    plain["job"] = Job(**{name: tuples(value) for name, value in job.items()})
    return Trial(**plain)  # type: ignore[arg-type]


def run(calibrator: str, every: list[Job], workers: int, folder: Path) -> list[Trial]:
    """All trials of a calibrator, those that are kept and those that are missing."""
    path = folder / f"{calibrator}.jsonl"
    done = kept(path)
    missing = [job for job in every if job.seed not in done or done[job.seed].job != job]
    with path.open("a") as out, ProcessPoolExecutor(workers) as pool:
        for n, trial in enumerate(_results(pool, missing), 1):
            out.write(json.dumps(asdict(trial)) + "\n")
            out.flush()
            done[trial.job.seed] = trial
            if n % 50 == 0 or n == len(missing):
                print(f"{calibrator}: {n} of {len(missing)}", file=sys.stderr, flush=True)
    return [done[job.seed] for job in every]


def _results(pool: ProcessPoolExecutor, missing: list[Job]) -> Iterator[Trial]:
    return pool.map(one, missing, chunksize=4)


def main() -> None:
    """Run what is asked for and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scale", type=float, default=1.0)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--only", nargs="*", choices=list(WORLDS), default=list(WORLDS))
    parser.add_argument("--scenarios", nargs="*", default=[""], help="beginnings of their names")
    parser.add_argument("--keep", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        for calibrator in options.only:
            asked = [
                job
                for job in jobs(calibrator, options.scale)
                if job.scenario.startswith(tuple(options.scenarios))
            ]
            print(table(calibrator, run(calibrator, asked, options.jobs, folder)))


if __name__ == "__main__":
    main()
