"""The marks of `imucal lab`: simulated benches, with and without an effect, and measured data.

Prints one Markdown table a part; `benchmarks/RESULTS.md` holds the last run. Usage:

    python benchmarks/lab/benches.py [--benches 200] [--jobs 2] [--data FOLDER]
"""

from __future__ import annotations

import argparse
import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from imucalib.calibration.uncertainty import angle_uncertainty, correct_readings, select_correctable
from imucalib.calibrators.lab.bench import position_observations
from imucalib.calibrators.lab.calibrate import calibrate
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.simulation import SENSOR, BenchPlan, simulate_table
from imucalib.calibrators.planted import plant_model
from imucalib.core.angle_conventions import Conventions
from imucalib.core.effect import Context
from imucalib.core.observations import Observations
from imucalib.core.references import angles_of, unit_vector
from imucalib.units import DEG, MG, STANDARD_GRAVITY

Array = NDArray[np.float64]
OFFSET = 1.0  # deg, the planted inclination offset


def planted_truth(plan: BenchPlan, data: Observations, force: Array) -> Array:
    """Noise-free readings (n, 3) m/s² of the planted sensor at specific forces (n, 3) m/s²."""
    model, theta = plant_model({**SENSOR, **plan.plant}, data.context)
    slices = model.slices(data.context)
    sensor = select_correctable(model)
    own = np.concatenate([theta[slices[name]] for name in sensor.names])
    covariates = {k: np.full(len(force), np.median(v)) for k, v in data.context.covariates.items()}
    return sensor.predict(own, force[:, None], Context(len(force), covariates)).reading[:, 0]


@dataclass(frozen=True)
class Bench:
    """What one simulated bench gave."""

    alarm: bool
    found: bool
    covered: bool
    inclination_covered: int
    tool_face_covered: int
    attitudes: int
    seconds: float


def one(job: tuple[int, float]) -> Bench:
    """Simulate, calibrate and judge one bench: job is (seed, planted inclination offset in deg)."""
    seed, offset = job
    rng = np.random.default_rng(seed)
    plan = BenchPlan(plant={"inclination_zero": (offset,)} if offset else {}, setting=(0.3, 0.4))
    table = simulate_table(plan, rng)
    data = position_observations(table, table.raw() * MG, Conventions(), STANDARD_GRAVITY)
    start = time.process_time()
    result = calibrate(data, LabRequest())
    seconds = time.process_time() - start
    loop, fit = result.loop, result.final
    assert loop is not None
    steps = [s.effect for s in loop.steps]
    others = [s for s in steps if s != "inclination_zero" or not offset]
    found, covered = "inclination_zero" in steps, False
    if found and offset:
        k = fit.model.slices(data.context)["inclination_zero"].start
        direction = np.eye(fit.theta.size)[k]
        covered = abs(fit.theta[k] - offset) <= fit.half_width(direction)
    inclination = rng.uniform(-60.0, 80.0, 20) * DEG
    tool_face = rng.uniform(0.0, 360.0, 20) * DEG
    force = STANDARD_GRAVITY * unit_vector(inclination, tool_face)
    reading = planted_truth(plan, data, force)
    corrected = correct_readings(loop.final, reading)
    i, t = angles_of(corrected)
    stated = angle_uncertainty(loop.final, inclination, tool_face, STANDARD_GRAVITY, MG)
    turn = np.mod(t - tool_face + np.pi, 2 * np.pi) - np.pi
    return Bench(
        bool(others or loop.unexplained or loop.records),
        found,
        bool(covered),
        int(np.sum(np.abs(i - inclination) / DEG <= stated.inclination_95)),
        int(np.sum(np.abs(turn) / DEG <= stated.tool_face_95)),
        20,
        seconds,
    )


def share(hits: int, count: int) -> str:
    """ "96.5 % (193/200)" """
    return f"{100.0 * hits / count:.1f} % ({hits}/{count})"


def simulated(benches: int, jobs: int) -> None:
    """Tables of false alarms, detection and coverage."""
    with ProcessPoolExecutor(jobs) as pool:
        clean = list(pool.map(one, [(10_000 + k, 0.0) for k in range(benches)]))
        off = list(pool.map(one, [(20_000 + k, OFFSET) for k in range(benches)]))
    both = clean + off
    total = sum(b.attitudes for b in both)
    named = sum(b.found for b in off)
    rows = [
        ("clean: any alarm", share(sum(b.alarm for b in clean), benches), "<= 5 %"),
        (f"{OFFSET:g} deg inclination offset: found", share(named, benches), ">= 98 %"),
        ("its 95 % interval covers", share(sum(b.covered for b in off), named), "92-98 %"),
        ("beside it: any other alarm", share(sum(b.alarm for b in off), benches), "-"),
        ("stated 95 % of inclination covers",
         share(sum(b.inclination_covered for b in both), total), "92-98 %"),
        ("stated 95 % of tool-face covers",
         share(sum(b.tool_face_covered for b in both), total), "92-98 %"),
        ("CPU seconds a bench, median", f"{np.median([b.seconds for b in both]):.2f}", "-"),
    ]  # fmt: skip
    print(f"| {benches} simulated benches each | measured | mark |\n|---|---|---|")
    for row in rows:
        print(f"| {' | '.join(row)} |")


def main() -> None:
    """Run both parts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--benches", type=int, default=200)
    parser.add_argument("--jobs", type=int, default=2)
    beside = Path(__file__).parents[2].parent / "shared" / "data"
    parser.add_argument("--data", type=Path, default=beside)
    options = parser.parse_args()
    simulated(options.benches, options.jobs)
    if options.data.is_dir():
        from measured import measured

        print()
        measured(options.data)


if __name__ == "__main__":
    main()
