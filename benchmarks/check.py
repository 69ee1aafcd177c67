"""The marks of `imucal check`: false alarms, shifts that are found, the power that is stated
against the power had, and false alarms of repeated checks.

Sensors, calibrations and checks are made in plain numpy; the program calibrates and checks. Usage:

    python benchmarks/check.py [--runs 400] [--jobs 1]
"""

from __future__ import annotations

import argparse
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import numpy as np

from imucalib.calibration.calibration import Calibration, from_fit
from imucalib.calibration.checking.misfit import misfits_of
from imucalib.calibration.checking.noise import check_noise
from imucalib.calibration.checking.statistic import Statistic
from imucalib.calibrators.lab.bench import position_observations, still_observations
from imucalib.calibrators.lab.calibrate import base_model
from imucalib.calibrators.lab.conventions import Conventions
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import noise_block
from imucalib.core.observations import Observations
from imucalib.estimators.least_squares import fit
from worlds.instrument import Array, Bench, G, Instrument, four, instrument, positions

ALPHA = 0.05


@dataclass(frozen=True)
class World:
    """known : positions with angles, else rests in unknown attitudes; noise mg, setting deg;
    rests of the calibration; the check has four"""

    known: bool
    noise: float
    setting: float
    calibrated: int


WORLDS = {
    "rests": World(False, 0.25, 0.0, 24),
    "rests, 0.4 mg": World(False, 0.40, 0.0, 24),
    "positions": World(True, 0.25, 0.01, 32),
    "positions, few": World(True, 0.25, 0.01, 12),
}


def recorded(
    world: World, tool: Instrument, angles: tuple[Array, Array], rng: np.random.Generator
) -> Observations:
    """What is read in some attitudes, as the program gets it."""
    bench = Bench(world.known, world.noise, world.setting)
    inclination, tool_face, reading = bench.sheet(tool, angles, rng)
    columns = {"inclination": inclination, "tool_face": tool_face}
    table = PositionTable(columns, {}, {}, np.arange(inclination.size), "", "")
    if world.known:
        return position_observations(table, reading, Conventions(), G, sigma=1.0)
    return still_observations(table, reading, G, sigma=1.0)


def calibrated(world: World, tool: Instrument, rng: np.random.Generator) -> Calibration:
    """By the program, without its search."""
    data = recorded(world, tool, positions(world.calibrated, rng), rng)
    made = fit(base_model(LabRequest(), data), data)
    facts = {"noise": noise_block(made)}
    return from_fit(
        made, "lab", raw_unit="m/s2", raw_to_si=1.0, gravity=G, status="ok", reasons=(), facts=facts
    )


@dataclass(frozen=True)
class Trial:
    """p by kind of shift; stated : shift that the check says it could see"""

    p: dict[str, float]
    stated: dict[str, float]


def trial(job: tuple[str, int]) -> Trial:
    """One device: calibrated, then checked unchanged and after every shift."""
    name, seed = job
    world = WORLDS[name]
    rng = np.random.default_rng([seed, len(name)])
    tool = instrument(rng)
    made = calibrated(world, tool, rng)
    noise = check_noise(made)
    angles = four(rng)
    along = rng.standard_normal(3)
    along /= np.linalg.norm(along)
    shifts = {"none": ("bias", 0.0, along), "bias 1.5 mg": ("bias", 1.5, along)}
    if world.known:
        shifts["mounting 0.1 deg"] = ("mounting", 0.1, along)
    first = Statistic(misfits_of(made, recorded(world, tool, angles, rng), noise)[0], seed=seed)
    stated = {}
    for kind in first.columns:
        worst = first.worst(kind)
        stated[kind] = first.seen(kind)
        if kind != "scale" and worst is not None:
            shifts[f"stated {kind}"] = (kind, stated[kind], worst * rng.choice([-1.0, 1.0]))
    p = {}
    for what, (kind, size, direction) in shifts.items():
        now = recorded(world, tool.changed(kind, size, direction), angles, rng)
        misfits, _ = misfits_of(made, now, noise)
        p[what] = Statistic(misfits, seed=seed).p()
    return Trial(p, stated)


def repeated(job: tuple[str, int]) -> float:
    """Twenty checks of an unchanged sensor with one calibration: smallest p."""
    name, seed = job
    world = WORLDS[name]
    rng = np.random.default_rng([seed, 77])
    tool = instrument(rng)
    made = calibrated(world, tool, rng)
    noise = check_noise(made)
    smallest = 1.0
    for _ in range(20):
        misfits, _ = misfits_of(made, recorded(world, tool, four(rng), rng), noise)
        smallest = min(smallest, Statistic(misfits, seed=seed, draws=2000).p())
    return smallest


def share(hits: list[bool]) -> str:
    return f"{100.0 * np.mean(hits):.1f} %"


def main() -> None:
    """Print Markdown tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=400)
    parser.add_argument("--jobs", type=int, default=1)
    chosen = parser.parse_args()
    print("| world | shift | found (p <= 5 %) | stated, median |")
    print("|---|---|---|---|")
    with ProcessPoolExecutor(chosen.jobs) as pool:
        for name, world in WORLDS.items():
            trials = list(pool.map(trial, [(name, k) for k in range(chosen.runs)], chunksize=8))
            for what in trials[0].p:
                kind = what.removeprefix("stated ")
                size = [t.stated[kind] for t in trials] if what.startswith("stated") else []
                print(f"| {name}: {world.noise:g} mg, {world.setting:g} deg, "
                      f"{world.calibrated} + 4 | {what} "
                      f"| {share([t.p[what] <= ALPHA for t in trials])} "
                      f"| {f'{np.median(size):.2f}' if size else '-'} |", flush=True)  # fmt: skip
        each = list(pool.map(repeated, [("rests", k) for k in range(chosen.runs)], chunksize=8))
    print(f"\n20 checks of one calibration, nothing changed, {chosen.runs} devices: "
          f"p <= 5 % ever in {share([p <= ALPHA for p in each])}")  # fmt: skip


if __name__ == "__main__":
    main()
