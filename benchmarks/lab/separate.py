"""Whether the rests that `design --separate` advises end an ambiguity, on devices of plain numpy.

    python benchmarks/lab/separate.py angles [--devices 40] [--size 3]
    python benchmarks/lab/separate.py norm [--devices 40]
    python benchmarks/lab/separate.py warm [--devices 40] --size 1

angles: a two-axis table set within 0.02 deg, rivals by the shape of the response; norm: attitudes
by hand, by the size of gravity alone (without cross_axis, which gravity alone does not tell from
squares); warm: the second half of the table is warmer, so that a bias that follows it looks like a
step. A device is calibrated; where its name has rivals the advised rests are made from the same
truth and noise, appended, and all is searched again. Counted is how often one cause remains,
the true one, against what was promised; then the same of twice as many random rests.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1]))

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from imucalib.calibration.calibration import from_fit
from imucalib.calibrators.lab.calibrate import base_model
from imucalib.calibrators.lab.errors import setting_noise
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.next_recording import (
    Rests,
    describe_recorded,
    pool_of,
    read_block,
    rests_of,
)
from imucalib.core.effect import Context
from imucalib.core.fit import Fit
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm, KnownVector
from imucalib.effects import names_a_cause
from imucalib.estimators.starting_point import full_matrix_start
from imucalib.posterior.candidates import effects_to_search
from imucalib.posterior.closed_loop.closed import close_loop
from imucalib.posterior.closed_loop.found import FitLoop, Step
from imucalib.posterior.closed_loop.separation import ambiguities, separation

G = 9.80665
MG = G / 1000.0
COUNT, NOISE, DIAL = 24, 0.3, 0.02


@dataclass(frozen=True)
class Table:
    """Rests as they were set (deg, degC) and what was read (n, 3) mg; run : 0..1 over the first
    recording, beyond it afterwards"""

    inclination: np.ndarray
    tool_face: np.ndarray
    warm: np.ndarray
    run: np.ndarray
    reading: np.ndarray

    def with_(self, other: Table) -> Table:
        both = zip(vars(self).values(), vars(other).values(), strict=True)
        return Table(*(np.concatenate(pair) for pair in both))


@dataclass(frozen=True)
class Device:
    """reading = matrix f + bias + effect, f in mg; effect : (f, degC, run) -> (n, 3) mg"""

    matrix: np.ndarray
    bias: np.ndarray
    effect: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    rng: np.random.Generator

    def read(self, inclination, tool_face, warm, run) -> Table:
        """Set the dials, each a little off, and read."""
        off = DIAL * self.rng.standard_normal((2, len(inclination)))
        i, t = np.radians(inclination + off[0]), np.radians(tool_face + off[1])
        u = np.column_stack([np.cos(i) * np.sin(t), np.cos(i) * np.cos(t), np.sin(i)])
        reading = 1000.0 * u @ self.matrix.T + self.bias + self.effect(u, warm, run)
        reading = reading + NOISE * self.rng.standard_normal(reading.shape)
        return Table(inclination, tool_face, warm, run, reading)


def device(kind: str, truth: str, size: float, rng: np.random.Generator) -> Device:
    """A device whose effect has a size (mg, over its units) on every axis, signs at random."""
    own = size * rng.choice([-1.0, 1.0], 3) * rng.uniform(0.7, 1.3, 3)
    effects = {
        "quadratic": lambda u, warm, run: own * u**2,
        "asymmetry": lambda u, warm, run: own * np.abs(u),
        "temperature_bias": lambda u, warm, run: own * ((warm - 25.0) / 10.0)[:, None] + 0.0 * u,
        "bias_drift": lambda u, warm, run: own * (2.0 * run - 1.0)[:, None] + 0.0 * u,
    }
    matrix = np.eye(3) + 0.005 * rng.standard_normal((3, 3))
    return Device(matrix, 15.0 * rng.standard_normal(3), effects[truth], rng)


def first_table(kind: str, one: Device) -> Table:
    """Three rings of eight; by the size of gravity anywhere."""
    rng = one.rng
    if kind == "norm":
        z = 1.0 - (2.0 * np.arange(COUNT) + 1.0) / COUNT
        i = np.degrees(np.arcsin(z))
        t = np.mod(137.508 * np.arange(COUNT) + rng.uniform(0.0, 360.0), 360.0)
    else:
        i = np.repeat([0.0, 45.0, -45.0], COUNT // 3)
        t = np.tile(np.arange(0.0, 360.0, 45.0), 3) + np.repeat([0.0, 15.0, 30.0], COUNT // 3)
    run = np.linspace(0.0, 1.0, COUNT)
    warm = np.where(run < 0.5, 20.0, 30.0) if kind == "warm" else np.full(COUNT, 25.0)
    if kind == "warm":
        warm = warm + 0.5 * rng.standard_normal(COUNT)
    return one.read(i, t, warm, run)


def observed(kind: str, table: Table) -> Observations:
    n = len(table.reading)
    i, t = np.radians(table.inclination), np.radians(table.tool_face)
    previous = np.concatenate([table.reading[:1], table.reading[:-1]]) * MG
    covariates = {"record": np.arange(float(n)), "order": np.linspace(0.0, 1.0, n)}
    covariates |= {f"previous_{a}": previous[:, k] for k, a in enumerate("xyz")}
    if kind == "warm":
        covariates["temperature"] = table.warm
    if kind == "norm":
        reference = KnownNorm(n, G)
    else:
        covariates |= {"inclination": i, "tool_face": t}
        held = [np.concatenate([[0], np.cumsum(np.diff(a) != 0.0)]) for a in (i, t)]
        reference = KnownVector(i, t, G, held[0], held[1])
    reading = table.reading[:, None] * MG
    label = tuple(f"row {k + 1}" for k in range(n))
    sigma = np.full((n, 1, 3), MG)
    return Observations(reading, sigma, reference, Context(n, covariates), np.arange(n), label)


def search(kind: str, table: Table) -> FitLoop:
    data = observed(kind, table)
    request = LabRequest(without=("cross_axis",) if kind == "norm" else ())
    model = base_model(request, data)
    wanted = effects_to_search((), request.without, {})
    start = full_matrix_start(model, data)
    return close_loop(model, data, wanted, start).loop


def calibration_of(fit: Fit):
    return from_fit(fit, "lab", raw_unit="mg", raw_to_si=MG, gravity=G, status="", reasons=(),
                    facts={})  # fmt: skip


def recorded(one: Device, kind: str, table: Table, rests: Rests, truth: str) -> bool:
    """Whether one cause remains, the right one, once these rests are recorded too."""
    n = rests.n
    warm = rests.levels.get("temperature", np.full(n, 25.0))
    run = 1.0 + (1.0 + np.arange(n)) / (COUNT - 1)
    i, t = np.degrees(rests.inclination), np.degrees(rests.tool_face)
    if kind == "norm":  # held by hand
        i, t = i + 3.0 * one.rng.standard_normal(n), t + 3.0 * one.rng.standard_normal(n)
    steps = search(kind, table.with_(one.read(i, t, warm, run))).steps
    return [causes(step) for step in steps] == [{truth}]


def causes(step: Step) -> set[str]:
    """Names of causes among an effect and its rivals."""
    return set(filter(names_a_cause, (step.effect, *step.aliases)))


@dataclass(frozen=True)
class Trial:
    """promised : probability that the plan's rests end it; planned, random : whether they did, and
    twice as many random ones"""

    rests: int
    promised: float
    planned: bool
    random: bool


def trial(kind: str, truth: str, size: float, seed: int) -> Trial | None:
    """None where the first table leaves no ambiguity with the truth in it, or rests cannot end
    it."""
    one = device(kind, truth, size, np.random.default_rng((seed, len(kind), len(truth))))
    table = first_table(kind, one)
    loop = search(kind, table)
    found = [a for a in ambiguities(loop.final, loop.alternatives) if truth in a.rivals]
    if not found or len(loop.steps) != 1:
        return None
    fit = loop.as_recorded
    reading = fit.noise.factor * float(np.median(fit.observations.sigma))
    block = describe_recorded(fit, found, reading=reading, settings=setting_noise(fit))
    kept = read_block(block, "here")
    rests = rests_of(kept, found[0])
    made = separation(found[0], pool_of(kept, calibration_of(fit), found[0], rests))
    if truth not in made.ends:
        return None
    some = np.random.default_rng(seed).integers(0, rests.n, 2 * len(made.plan))
    return Trial(
        rests=len(made.plan),
        promised=made.ends[truth],
        planned=recorded(one, kind, table, rests.take(np.array(made.plan)), truth),
        random=recorded(one, kind, table, rests.take(some), truth),
    )


TRUTHS = {"angles": ("quadratic", "asymmetry"), "norm": ("quadratic", "asymmetry"),
          "warm": ("temperature_bias",)}  # fmt: skip


def main() -> None:
    """One line a truth."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=list(TRUTHS))
    parser.add_argument("--devices", type=int, default=40)
    parser.add_argument("--size", type=float, default=3.0)
    asked = parser.parse_args()
    print("| what | truth | ambiguous | rests | promised | planned | random, twice as many |")
    for truth in TRUTHS[asked.what]:
        every = [trial(asked.what, truth, asked.size, seed) for seed in range(asked.devices)]
        told = [one for one in every if one is not None]
        if told:
            rests = np.median([one.rests for one in told])
            rates = (
                np.mean([vars(one)[k] for one in told]) for k in ("promised", "planned", "random")
            )
            cells = (asked.what, truth, f"{len(told)} of {asked.devices}", f"{rests:.0f}")
            print(
                "| " + " | ".join((*cells, *(f"{100.0 * r:.0f} %" for r in rates))) + " |",
                flush=True,
            )


if __name__ == "__main__":
    main()
