"""Whether the postures that `design --separate` advises end an ambiguity of a worn sensor.

    python benchmarks/actigraph/separate.py [--devices 20] [--truth temperature_bias ...]

A device is made by plain numpy: three days of posture runs about few habits, a temperature that
follows the hour of the day, 0.4 mg from run to run. Where its name has rivals the advised postures
are held, a run each, on the day after; all is searched again. `right` is one name and the true one,
without rivals + with a form beside it that has no cause; then the same of twice as many postures
that determine the nine parameters best, and of random ones.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1]))

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from separating import best_of, right, row, told_of

from imucalib.calibration.calibration import from_fit
from imucalib.calibrators.actigraph.calibrate import ActigraphResult, calibrate
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.actigraph.simulation import postures, scan_of
from imucalib.calibrators.separate.candidates import Rests, pool_of, rests_of
from imucalib.calibrators.separate.plan import after_a_power_up
from imucalib.calibrators.separate.recorded import recorded_block, recorded_of
from imucalib.loop.separation.plan import separation
from imucalib.rests.runs import PostureRuns
from imucalib.units import MG

G, DAY, DAYS, RUNS, SCATTER = 9.80665, 86400.0, 3.0, 300, 0.4
REQUEST = replace(ActigraphRequest(), without=("cross_axis",), curves=False)
SIZES = {"temperature_bias": 0.12, "time_of_day": 0.8, "asymmetry": 1.5, "quadratic": 2.0}


@dataclass(frozen=True)
class Device:
    """effect : (f in g (n, 3), degC, s) -> (n, 3) mg"""

    matrix: np.ndarray
    bias: np.ndarray
    effect: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    rng: np.random.Generator

    def read(self, u: np.ndarray, warm: np.ndarray, time: np.ndarray) -> np.ndarray:
        reading = 1000.0 * u @ self.matrix.T + self.bias + self.effect(u, warm, time)
        return (reading + SCATTER * self.rng.standard_normal(reading.shape)) * MG


def device(truth: str, rng: np.random.Generator) -> Device:
    own = SIZES[truth] * rng.choice([-1.0, 1.0], 3) * rng.uniform(0.7, 1.3, 3)
    effects = {
        "temperature_bias": lambda u, warm, time: own * (warm - 25.0)[:, None] + 0.0 * u,
        "time_of_day": lambda u, warm, time: (
            own * np.sin(2.0 * np.pi * time / DAY)[:, None] + 0.0 * u
        ),
        "asymmetry": lambda u, warm, time: own * np.abs(u),
        "quadratic": lambda u, warm, time: own * u**2,
    }
    matrix = np.eye(3) + np.tril(0.01 * rng.standard_normal((3, 3)))
    return Device(matrix, 20.0 * rng.standard_normal(3), effects[truth], rng)


def runs_of(reading: np.ndarray, time: np.ndarray, warm: np.ndarray) -> PostureRuns:
    n = len(time)
    return PostureRuns(
        mean=reading, windows=np.full(n, 6, np.intp), time=time, temperature=warm,
        window_noise=0.1 * MG, still=6 * n, total=12 * n, noise=np.full(3, 4.0 * MG),
    )  # fmt: skip


def warmth(time: np.ndarray) -> np.ndarray:
    return 30.0 + 3.0 * np.sin(2.0 * np.pi * time / DAY + 0.3)


def search(runs: PostureRuns, thermometer: np.ndarray, stop: float) -> ActigraphResult:
    """thermometer : (2, n) times and temperatures, straight between them"""
    grid = np.arange(5.0, stop, 60.0)
    scan = scan_of(grid, np.interp(grid, *thermometer), rate=100.0, seconds=stop)
    return calibrate(runs, scan, REQUEST)


def held(one: Device, runs: PostureRuns, rests: Rests, truth: str) -> str:
    """Whether the name is right and alone once these postures were held, within 8 deg by hand.
    Where the temperature before counts, eight hours of it come before each."""
    u = rests.direction + 0.14 * one.rng.standard_normal((rests.n, 3)) / 3.0**0.5
    u = u / np.linalg.norm(u, axis=1, keepdims=True)
    hour = rests.levels.get("time_of_day", np.full(rests.n, 0.3)) * DAY / (2.0 * np.pi)
    turn = "temperature_before" in rests.levels
    between = np.arange(rests.n) * (2.0 * DAY if turn else 120.0) + (DAY if turn else 3600.0)
    time = DAYS * DAY + hour + between
    warm = rests.levels.get("temperature", warmth(time)) + 0.2 * one.rng.standard_normal(rests.n)
    before = rests.levels.get("temperature_before", warm)
    order = np.argsort(time)
    u, time, warm, before = u[order], time[order], warm[order], before[order]
    steps = list(zip(time, warm, strict=True))
    if turn:
        steps = [
            (t + away, value)
            for t, now, then in zip(time, warm, before, strict=True)
            for away, value in ((-28800.0, then), (-300.0, then), (-240.0, now), (100.0, now))
        ]
    both = [(runs.mean, one.read(u, warm, time)), (runs.time, time), (runs.temperature, warm)]
    grown = runs_of(*(np.concatenate(pair) for pair in both))
    series = np.column_stack([(runs.time, runs.temperature), np.array(steps).T])
    return right(search(grown, series, float(time[-1]) + 60.0).loop, truth)


def trial(truth: str, seed: int) -> dict[str, object] | None:
    one = device(truth, np.random.default_rng((seed, len(truth))))
    rng = one.rng
    time = np.sort(rng.uniform(0.0, DAYS * DAY, RUNS))
    warm = warmth(time) + 0.3 * rng.standard_normal(RUNS)
    runs = runs_of(one.read(postures(RUNS, rng), warm, time), time, warm)
    result = search(runs, np.array([runs.time, runs.temperature]), DAYS * DAY)
    loop = result.loop
    found = [a for a in loop.ambiguous if truth in a.rivals] if loop else []
    if not found or result.declined or len(loop.named) != 1 or loop.wander is None:
        names = [(s.effect, s.aliases) for s in loop.steps] if loop else []
        return {"clear": names}
    said = loop.wander
    block = recorded_block(result.final, found, MG * said.scatter, {}, said.sd)
    recorded = recorded_of(block, "here")
    fit = from_fit(result.final, "actigraph", raw_unit="m/s2", raw_to_si=1.0, gravity=G,
                   status="", reasons=(), facts={})  # fmt: skip
    rests = rests_of(recorded, found[0])
    pool, ambiguity = pool_of(recorded, fit, found[0], rests), found[0]
    if recorded.wander > 0.0:
        ambiguity, pool = after_a_power_up(ambiguity, pool, recorded.wander)
    made = separation(ambiguity, pool, np.random.default_rng(seed))
    n, told = len(made.plan), told_of(made, ambiguity, truth)
    if n:
        told["right"] = held(one, runs, rests.take(np.array(made.plan)), truth)
        told["informative 2"] = held(one, runs, rests.take(best_of(ambiguity, pool, 2 * n)), truth)
        told["random 2"] = held(one, runs, rests.take(rng.integers(0, rests.n, 2 * n)), truth)
    return told


def main() -> None:
    """One line a truth."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--devices", type=int, default=20)
    parser.add_argument("--truth", nargs="+", default=list(SIZES))
    asked = parser.parse_args()
    for truth in asked.truth:
        told = [trial(truth, seed) for seed in range(asked.devices)]
        if os.environ.get("SHOW"):
            print(*told, sep="\n", flush=True)
        told = [o for o in told if "rests" in o]
        print(
            row((truth,), asked.devices, told) if told else f"{truth}: none ambiguous", flush=True
        )


if __name__ == "__main__":
    main()
