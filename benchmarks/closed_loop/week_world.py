"""Wrist weeks for the acceptance benchmark: three days of posture runs, 0.4 mg from run to run."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from trial import Job, Trial, coverage, noise, norm_error, said, strengths

from imucalib.calibrators.actigraph.calibrate import NINE, calibrate
from imucalib.calibrators.actigraph.observations import covariates_of
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.actigraph.simulation import SENSOR, WeekPlan, simulated_week
from imucalib.core.context import Context
from imucalib.core.model import Model
from imucalib.effects import catalogue, named
from imucalib.loop.found import LoopSettings
from imucalib.rests.runs import PostureRuns
from imucalib.units import MG, STANDARD_GRAVITY

Array = NDArray[np.float64]

DAYS = 3.0
SCATTER = 0.4  # mg
SCANS = {"bias_step": "bias_step@{at:.0f}s", "thermal_lag": "thermal_lag@1.5h"}
OUTSIDE = {
    "random_walk": "order time",
    "shock_and_recovery": "order time",
    "scale_by_the_hour": "order time time-of-day",
}
NOISE = ("t4", "ar", "scatter")
CONFOUNDED: tuple[tuple[str, str, float], ...] = (
    ("temperature_bias", "", 0.1),
    ("time_of_day", "", 1.0),
    ("quadratic", "", 0.5),
    ("asymmetry", "", 0.5),
)
FAULTS: tuple[str, ...] = ()


def effects() -> tuple[str, ...]:
    """Sensor effects that a week can carry, scans by their names."""
    week = simulated_week(WeekPlan(days=DAYS), 0)
    context = Context(week.runs.n, covariates_of(week.runs, week.scanned))
    found = [
        e.name
        for e in catalogue().values()
        if e.stage == "sensor" and e.name not in NINE and not e.missing(context)
    ]
    return (*found, *SCANS)


def trial(job: Job) -> Trial:
    """Simulate a week, calibrate it, and judge."""
    rng = np.random.default_rng(job.seed)
    week = _Week(job, rng)
    request = ActigraphRequest(rules=LoopSettings(curves=job.outside is not None))
    started = time.process_time()
    result = calibrate(week.runs, week.scanned, request, rng)
    seconds = time.process_time() - started
    assert result.loop is not None
    known = ActigraphRequest(loop=False, declare=tuple(week.planted))
    oracle = calibrate(week.runs, week.scanned, known, rng).final
    reading, force, context = week.test(rng)
    truth = {name: np.array(v) for name, v in SENSOR.items()}
    covered, intervals = coverage(result.final, truth)
    found = Trial(
        job,
        strength=strengths(oracle, week.planted),
        before=norm_error(result.base, reading, force, context),
        after=norm_error(result.final, reading, force, context),
        oracle=norm_error(oracle, reading, force, context),
        covered=covered,
        intervals=intervals,
        seconds=seconds,
    )
    found = said(found, result.loop)
    return replace(found, sets=()) if result.declined else found


class _Week:
    """Posture runs with all that was planted in them."""

    def __init__(self, job: Job, rng: np.random.Generator) -> None:
        self.job = job
        clean = simulated_week(WeekPlan(days=DAYS, scatter=0.0), job.seed)
        self.scanned, blank = clean.scanned, clean.runs
        span = DAYS * 86400.0
        self.context = Context(blank.n, covariates_of(blank, self.scanned))
        self.planted: dict[str, Array] = {}
        for name, size in job.effects:
            full = SCANS.get(name, name).format(at=rng.uniform(0.2, 0.8) * span)
            typical = [p.typical for p in named(full).parameters(self.context)]
            self.planted[full] = size * np.array(typical) * rng.standard_normal(len(typical))
        self.model = Model(tuple(named(n) for n in (*NINE, *self.planted)))
        self.phase = rng.uniform(0.0, 2.0 * np.pi, 3)
        self.at = rng.uniform(0.2, 0.7) * span
        steps = rng.standard_normal((blank.n, 3)) / np.sqrt(blank.n)
        self.walk = np.cumsum(steps, axis=0)
        force = clean.force
        reading = self._sensed(force, self.context, np.arange(blank.n))
        self.runs: PostureRuns = replace(blank, mean=reading + MG * self._noise(force, blank, rng))

    def _noise(self, force: Array, runs: PostureRuns, rng: np.random.Generator) -> Array:
        """(n, 3) mg: white noise of the windows, and what all windows of a run share, along the
        force, since only the norm is seen."""
        white = runs.window_noise / MG / np.sqrt(runs.windows)
        shared = SCATTER * noise(self.job.noise, (runs.n,), rng)
        if self.job.noise == "scatter":
            bout = (runs.time / 3600.0).astype(int)
            shared = shared + 0.7 * rng.standard_normal(bout.max() + 1)[bout]
        along = force / np.linalg.norm(force, axis=1, keepdims=True)
        return np.asarray(
            shared[:, None] * along + white[:, None] * rng.standard_normal((runs.n, 3))
        )

    def _sensed(self, force: Array, context: Context, rows: Array) -> Array:
        theta, slices = self.model.start(context), self.model.slices(context)
        for name, values in {**SENSOR, **self.planted}.items():
            theta[slices[name]] = values
        reading = self.model.predict(theta, force[:, None], context).reading[:, 0]
        if not self.job.outside:
            return np.asarray(reading)
        name, size = self.job.outside
        if name == "random_walk":
            return np.asarray(reading + 3.0 * size * MG * self.walk[rows])
        t = context["time"]
        if name == "shock_and_recovery":
            since = np.maximum(t - self.at, 0.0)
            left = (t >= self.at) * np.exp(-since / (6.0 * 3600.0))
            return np.asarray(reading + 3.0 * size * MG * left[:, None] * np.sin(self.phase))
        wave = np.sin(2.0 * np.pi * t / (7.0 * 3600.0) + self.phase[0])
        return np.asarray(reading + 1e-3 * size * wave[:, None] * np.sin(self.phase) * force)

    def test(self, rng: np.random.Generator) -> tuple[Array, Array, Context]:
        """Noise-free readings at directions and conditions that the sensor may meet."""
        n = 400
        direction = rng.standard_normal((n, 3))
        force = STANDARD_GRAVITY * direction / np.linalg.norm(direction, axis=1, keepdims=True)
        rows = rng.integers(0, self.runs.n, n)
        context = self.context.take(rows)
        return self._sensed(force, context, rows), force, context
