"""Trials of `lab` on benches of tests/worlds/plain_bench.py, whose generator shares no code with
the command: what is planted at which strength, and how the calibration is judged.

The error is that of the sensor, at directions and in conditions that it may meet, against the true
specific force. Where a dial's tool-face is wrong, no reference says which way round is zero: there
the turn about the tool's axis is taken out.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from trial import Job, Trial, corrected, said

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from sheet_rows import rows

from imucalib.calibrators.lab.calibrate import LabSettings
from imucalib.calibrators.lab.position_table import read_position_table
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import LabRun, run_lab
from imucalib.core.context import Context
from imucalib.core.fit import Fit
from imucalib.errors import ImucalError
from imucalib.units import DEG, MG, STANDARD_GRAVITY
from worlds.plain_bench import Bench, Plan, conditions, direction
from worlds.plain_defects import AXES, DIALS, SCANNED, Conditions, member

__all__ = ["jobs", "rows", "trial"]

Array = NDArray[np.float64]

EFFECTS = (
    "temperature_bias", "temperature_square", "temperature_scale", "bias_drift", "scale_drift",
    "warm_up", "bias_step", "scale_step", "inclination_step", "hysteresis", "approach_hysteresis",
    "quadratic", "cubic", "asymmetry", "cross_axis", "inclination_zero", "inclination_scale",
    "inclination_sag", "inclination_eccentricity", "inclination_wobble", "inclination_backlash",
    "tool_face_eccentricity", "tool_face_ellipticity", "tool_face_backlash", "base_tilt_across",
    "axis_non_orthogonality", "clamp_creep",
)  # fmt: skip
OUTSIDE = (
    "third_harmonic", "local_sine", "thermal_lag", "random_walk", "shock", "slip", "late_reading",
    "pick_up", "quantisation", "soft_saturation",
)  # fmt: skip
CONVERTER = "response:xyz:sine:0.47:0.9"
TAKEN = ("temperature_bias", "bias_drift", "bias_step", CONVERTER)
FORMS = (
    "response:xyz:sine:0.37:0.5", "response:y:sine:0.61:2.1", "tool_face:tool_face:sine:72:1.1",
    "bias:temperature:sine:9:0.4", "response:xz:power:5:0:1", "bias:order:power:3:0.5:0.5",
    "bias:temperature:kink:27", "response:x:kink:0.35", "response:xyz:saturation:0.6",
    "response:yz:soft_saturation:0.55", "response:xyz:saw_tooth:0.43:0.3",
    "bias:order:exponential:0.12:0",
)  # fmt: skip
JUNK = (
    "temperature_bias", "temperature_scale", "bias_drift", "scale_drift", "warm_up", "quadratic",
    "cubic", "asymmetry", "cross_axis",
)  # fmt: skip
TURNING = {*DIALS, *AXES}


def _recipes() -> Iterator[tuple[str, int, dict[str, object]]]:
    """Scenario, trials at scale 1, and what is in it; λ below is a target, met exactly."""
    yield "clean", 400, {}
    for name in TAKEN:
        yield "taken", 25, {"effects": ((name, 10.0), (name, 16.0)), "noise": "ar"}
    for name in EFFECTS:
        yield "one", 5, {"effects": ((name, 6.0), (name, 10.0))}
        yield "strong", 5, {"effects": ((name, 10.0), (name, 25.0))}
    draw = np.random.default_rng(11)
    for _ in range(12):
        pair = draw.choice(len(EFFECTS), 2, replace=False)
        yield "two", 10, {"effects": tuple((EFFECTS[k], 12.0) for k in pair)}
    for name in OUTSIDE:
        yield "outside", 10, {"outside": (name, 25.0)}
    for name in FORMS:
        yield "form", 8, {"outside": (name, 30.0)}
    yield "junk", 300, {"junk": JUNK}


def jobs(scale: float) -> Iterator[Job]:
    """Seeds do not depend on the scale, so that a larger run goes on from a smaller one."""
    for k, (scenario, number, recipe) in enumerate(_recipes()):
        for n in range(max(1, round(number * scale))):
            seed = 40_000_000 + 1000 * k + n
            yield Job("sheets", scenario, seed, **_drawn(scenario, recipe, seed))  # type: ignore[arg-type]


def _drawn(scenario: str, recipe: dict[str, object], seed: int) -> dict[str, object]:
    """A range of λ becomes one effect of a λ in it; of the junk three pieces are taken."""
    rng = np.random.default_rng((seed, 2))
    if scenario == "junk":
        return {"junk": tuple(str(j) for j in rng.choice(JUNK, 3, replace=False))}
    if scenario in ("taken", "one", "strong"):
        (name, low), (_, high) = recipe["effects"]  # type: ignore[misc]
        return {**recipe, "effects": ((name, round(float(rng.uniform(low, high)), 3)),)}
    return recipe


def _plan(job: Job) -> Plan:
    noise = "gauss" if job.noise == "gaussian" else job.noise
    planted = job.effects + ((job.outside,) if job.outside else ())
    coarse = job.outside is not None and job.outside[0] == "quantisation"
    return Plan(
        job.seed,
        () if coarse else planted,
        noise=noise,
        n=60 if job.scenario == "form" or (planted and ":" in planted[0][0]) else 36,
        coarse=coarse,
    )


def trial(job: Job) -> Trial:
    """Write the sheet, run the whole command on it, and judge."""
    bench = Bench(_plan(job))
    if job.junk:
        return _junk(job, bench)
    started = time.process_time()
    try:
        run = solved(bench)
    except ImucalError as error:
        return Trial(job, refused=str(error), seconds=time.process_time() - started)
    seconds = time.process_time() - started
    result, loop = run.result, run.result.loop
    if loop is None:
        return Trial(job, refused="; ".join(run.outcome.undecided), seconds=seconds)
    oracle = result.base
    if bench.size and not job.outside:
        told = LabSettings(loop=False, declare=tuple(_told(bench, n) for n in bench.size))
        oracle = solved(bench, told).result.final
    covered, intervals = coverage(result.final, bench)
    held = run.outcome.errors[0].held_out
    found = Trial(
        job,
        strength=tuple(size for _, size in job.effects),
        before=sensor_error(result.base, bench),
        after=sensor_error(result.final, bench),
        oracle=sensor_error(oracle, bench),
        covered=covered,
        intervals=intervals,
        seconds=seconds,
        names=tuple(n for s in loop.steps for n in (s.effect, *s.aliases)),
        told=held.final - held.base,
    )
    return said(found, loop)


def solved(bench: Bench, settings: LabSettings | None = None) -> LabRun:
    """The command on the bench's sheet, as a user runs it unless settings say otherwise."""
    with tempfile.TemporaryDirectory() as folder:
        table = read_position_table(bench.write(Path(folder) / "sheet.csv"))
        return run_lab(table, LabRequest(unit="mg", settings=settings or LabSettings(), seed=0))


def _told(bench: Bench, name: str) -> str:
    if name in SCANNED:
        return member(name, bench.conditions.at)
    # The phase of a sine is fitted.
    return f"shape@{name.rpartition(':')[0]}" if ":sine:" in name else name


def sensor_error(fit: Fit, bench: Bench) -> float:
    """mg rms of the vector."""
    reading, force, c = bench.fresh(400, bench.plan.seed)
    away = corrected(fit, MG * reading, _context(fit, c, force, bench)) / MG - 1000.0 * force
    if TURNING & set(bench.size) or any(n.startswith("tool_face:") for n in bench.size):
        about = np.cross([0.0, 0.0, 1.0], force)
        away -= about * np.sum(away * about) / np.sum(about * about)
    return float(np.sqrt(np.mean(np.sum(away**2, axis=1))))


def _context(fit: Fit, c: Conditions, force: Array, bench: Bench) -> Context:
    """The conditions as the command knows them, by name."""
    previous = STANDARD_GRAVITY * c.previous @ bench.turn().T
    moved = (force - c.previous) @ bench.turn().T
    side = np.sign(moved) * (np.abs(moved) > 0.02)
    mine = {
        "record": c.row, "order": c.order, "temperature": c.temperature,
        "inclination": DEG * c.inclination, "tool_face": DEG * c.tool_face,
        "inclination_approach": c.approach_i, "tool_face_approach": c.approach_t,
        **{f"previous_{a}": previous[:, k] for k, a in enumerate("xyz")},
        **{f"approach_{a}": side[:, k] for k, a in enumerate("xyz")},
    }  # fmt: skip
    of = fit.observations.context
    # What is remembered of the temperature is that of the sheet's row.
    past = {
        name: values[c.row.astype(int)]
        for name, values in of.covariates.items()
        if name.startswith("temperature_") and len(values) == bench.plan.n
    }
    every = {**past, **mine, "sweep": np.zeros(len(c.row))}
    return Context(len(c.row), every, sweeps=of.sweeps)


def coverage(fit: Fit, bench: Bench) -> tuple[int, int]:
    """95 % intervals of the twelve parameters, and of a planted effect's, that hold the truth."""
    truth = {
        "bias": bench.bias, "scale": bench.scale, "non_orthogonality": bench.cross,
        "mounting": bench.mounting, **bench.size,
    }  # fmt: skip
    slices, hits, count = fit.model.slices(fit.observations.context), 0, 0
    for name, values in truth.items():
        if name not in slices or name in TURNING:  # the sense of a fixture's turn is a convention
            continue
        for k, value in zip(range(slices[name].start, slices[name].stop), values, strict=True):
            hits += bool(abs(fit.theta[k] - value) <= fit.half_width(np.eye(fit.theta.size)[k]))
            count += 1
    return hits, count


def _junk(job: Job, bench: Bench) -> Trial:
    """What the report says that declaring effects does which are not there, and what it does to
    sheets of the same sensor that were made anew."""
    started = time.process_time()
    plain = solved(bench, LabSettings(loop=False))
    full = solved(bench, LabSettings(loop=False, declare=job.junk))
    told = [r.outcome.errors[0].held_out.final for r in (plain, full)]
    new = np.mean([_anew(bench, (plain, full), k) for k in range(20)], axis=0)
    return Trial(
        job,
        told=told[1] ** 2 - told[0] ** 2,
        new=float(new[1] - new[0]),
        seconds=time.process_time() - started,
    )


def _anew(bench: Bench, runs: Sequence[LabRun], k: int) -> Array:
    """mg², mean square of the vector error of each fit on another sheet of the same sensor."""
    rng = np.random.default_rng((bench.plan.seed, 3, k))
    c = replace(conditions(rng, bench.plan.n), phase=bench.conditions.phase)
    reading = bench.noted(c, rng)
    meant = direction(c.inclination, c.tool_face)
    fits = [run.result.final for run in runs]
    away = [corrected(f, MG * reading, _context(f, c, meant, bench)) / MG for f in fits]
    away = [a - 1000.0 * meant for a in away]
    return np.array([np.mean(np.sum(a**2, axis=1)) for a in away])
