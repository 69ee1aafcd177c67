"""The marks of `imucal check`: false alarms and power as stated against those had, changes that are
found, and false alarms of repeated checks.

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
from imucalib.calibration.checking.check import Measured, SensorCheck, check
from imucalib.calibration.checking.misfit import change_question, misfits_of
from imucalib.calibration.checking.noise import check_noise
from imucalib.calibrators.lab.bench import position_observations, still_observations
from imucalib.calibrators.lab.calibrate import base_model
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import noise_block
from imucalib.core.angle_conventions import Conventions
from imucalib.core.observations import Observations
from imucalib.estimators.least_squares import fit
from worlds.instrument import Array, Bench, G, Instrument, four, instrument, positions


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


def checked(calibration: Calibration, now: Observations) -> SensorCheck:
    """The check of one recording, with the limit by default."""
    noise = check_noise(calibration)
    misfits, _ = misfits_of(calibration, now, noise)
    return check(calibration, [Measured(misfits)], noise, {}).sensors[0]


@dataclass(frozen=True)
class Trial:
    """told, changed, right : by kind of shift, whether anything was told, a change of the sensor,
    and that one among its causes
    nothing : probability that nothing changed; stated : size that the check says it could see, and
    its false alarms"""

    told: dict[str, bool]
    changed: dict[str, bool]
    right: dict[str, bool]
    nothing: dict[str, float]
    stated: dict[str, float]


def trial(job: tuple[str, int]) -> Trial:
    """One device: calibrated, then checked unchanged and after every shift."""
    name, seed = job
    world = WORLDS[name]
    rng = np.random.default_rng([seed, len(name)])
    tool = instrument(rng)
    made = calibrated(world, tool, rng)
    angles = four(rng)
    along = rng.standard_normal(3)
    along /= np.linalg.norm(along)
    shifts = {"none": ("bias", 0.0, along)}
    shifts |= {f"bias {size} mg": ("bias", size, along) for size in (1.0, 1.5, 2.0)}
    shifts["scale 0.1 %"] = ("scale", 1.0, np.eye(3)[rng.integers(3)])
    if world.known:
        shifts |= {f"mounting {size} deg": ("mounting", size, along) for size in (0.05, 0.1)}
    first = checked(made, recorded(world, tool, angles, rng))
    question = change_question(first.misfits, dict.fromkeys(("bias", "scale", "mounting"), 1.0))
    stated = {"none": first.false_alarm}
    for k, (kind, own) in enumerate(first.sizes.items()):
        worst = question.worst(k)
        if worst is not None:
            stated[f"stated {kind}"] = own.seen
            shifts[f"stated {kind}"] = (kind, own.seen, worst * rng.choice([-1.0, 1.0]))
    told, changed, right, nothing = {}, {}, {}, {}
    for what, (kind, size, direction) in shifts.items():
        found = checked(made, recorded(world, tool.changed(kind, size, direction), angles, rng))
        told[what] = found.answer.told
        changed[what] = found.changed
        right[what] = kind in found.causes
        nothing[what] = found.answer.nothing
    return Trial(told, changed, right, nothing, stated)


def repeated(job: tuple[str, int]) -> bool:
    """Twenty checks of an unchanged sensor with one calibration: whether any tells a change."""
    name, seed = job
    world = WORLDS[name]
    rng = np.random.default_rng([seed, 77])
    tool = instrument(rng)
    made = calibrated(world, tool, rng)
    every = (checked(made, recorded(world, tool, four(rng), rng)) for _ in range(20))
    return any([one.answer.told for one in every])


def share(hits: list[bool]) -> str:
    return f"{100.0 * np.mean(hits):.1f} %"


def main() -> None:
    """Print Markdown tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=400)
    parser.add_argument("--jobs", type=int, default=1)
    chosen = parser.parse_args()
    print("| world | shift | told | changed | as this kind | unchanged, mean | stated, mean |")
    print("|---|---|---|---|---|---|---|")
    with ProcessPoolExecutor(chosen.jobs) as pool:
        for name, world in WORLDS.items():
            trials = list(pool.map(trial, [(name, k) for k in range(chosen.runs)], chunksize=8))
            for what in dict.fromkeys(w for t in trials for w in t.told):
                some = [t for t in trials if what in t.told]
                size = [t.stated[what] for t in some if what in t.stated]
                print(f"| {name}: {world.noise:g} mg, {world.setting:g} deg, "
                      f"{world.calibrated} + 4 | {what} "
                      f"| {share([t.told[what] for t in some])} "
                      f"| {share([t.changed[what] for t in some])} "
                      f"| {share([t.right[what] for t in some])} "
                      f"| {np.mean([t.nothing[what] for t in some]):.2f} "
                      f"| {f'{np.mean(size):.3f}' if size else '-'} |", flush=True)  # fmt: skip
        each = list(pool.map(repeated, [("rests", k) for k in range(chosen.runs // 4)]))
    print(f"\n20 checks of one calibration, nothing changed, {len(each)} devices: "
          f"a change ever told in {share(each)}")  # fmt: skip


if __name__ == "__main__":
    main()
