"""A week on the wrist as posture runs, without making every sample, and sample by sample."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.actigraph import simulation
from imucalib.calibrators.actigraph.observations import covariates_of
from imucalib.calibrators.actigraph.simulation import postures, temperature_at
from imucalib.calibrators.planted import plant_model
from imucalib.core.effect import Context
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.runs import PostureRuns, Scan
from imucalib.rests.thermal import ThermalHistory
from imucalib.rests.windows import Windows
from imucalib.units import MG, STANDARD_GRAVITY

DAY = 86400.0
POSTURE = 120.0  # s, mean length of a posture at rest


@dataclass(frozen=True)
class WeekPlan(simulation.WeekPlan):
    """scatter : mg, norm error that all windows of a posture share; curve : per axis, reading in g
    -> mg, a converter's own non-linearity"""

    scatter: float = 0.4
    curve: Callable[[Array], Array] | None = None


@dataclass(frozen=True)
class Week:
    """Simulated runs with the scan that they would come from, and the true specific force (n, 3)
    m/s², without noise, in the frame that keeps x."""

    runs: PostureRuns
    scanned: Scan
    force: Array
    plan: WeekPlan


def scan_of(grid: Array, warm: Array | None, *, rate: float, seconds: float) -> Scan:
    """A scan that no samples made: its thermometer reads `warm` (t,) in °C at `grid` (t,) in s."""
    nothing = np.zeros((0, 3))
    return Scan(
        windows=Windows(
            samples=1000,
            first=np.zeros(0, np.intp),
            run=np.zeros(0, np.intp),
            start=np.zeros(0),
            stop=np.zeros(0),
            mean=nothing,
            variance=nothing,
            low=nothing,
            high=nothing,
            finest=np.zeros(3),
        ),
        temperature=None if warm is None else ThermalHistory(grid, warm),
        triad="imu0",
        rate=rate,
        samples=int(seconds * rate),
        stop=seconds,
        gaps=0,
        path="simulated",
        format="simulated",
        sha256="",
        start_ns=0,
        notes=(),
    )


def simulated_week(plan: WeekPlan, seed: int) -> Week:
    """Posture runs as detection would give them."""
    rng = np.random.default_rng(seed)
    seconds = plan.days * DAY
    n = max(12, int(plan.rests * seconds / POSTURE))
    time = np.sort(rng.uniform(0.0, seconds, n))
    windows = 1 + rng.geometric(10.0 / POSTURE, n)
    force = plan.gravity * postures(n, rng)
    grid = np.arange(5.0, seconds, 60.0)
    warm = temperature_at(grid, seed)
    scanned = scan_of(grid, warm if plan.temperature else None, rate=plan.rate, seconds=seconds)
    window_noise = plan.noise * MG / np.sqrt(10.0 * plan.rate)
    blank = PostureRuns(
        mean=force,
        windows=windows.astype(np.intp),
        time=time,
        temperature=np.interp(time, grid, warm) if plan.temperature else np.full(n, np.nan),
        window_noise=window_noise,
        still=int(windows.sum()),
        total=int(seconds / 10.0),
        noise=np.full(3, plan.noise * MG),
    )
    spread = np.sqrt((plan.scatter * MG) ** 2 + window_noise**2 / windows)
    reading = sensed(plan, force, blank, scanned) + spread[:, None] * rng.standard_normal((n, 3))
    return Week(replace(blank, mean=reading), scanned, force, plan)


def sensed(plan: WeekPlan, force: Array, runs: PostureRuns, scanned: Scan) -> Array:
    """Noise-free readings (n, 3) of the planted sensor at specific forces (n, 3), m/s²."""
    context = Context(runs.n, covariates_of(runs, scanned))
    model, theta = plant_model({**plan.sensor, **plan.plant}, context)
    reading = model.predict(theta, force[:, None], context).reading[:, 0]
    if plan.curve is not None:
        reading = reading + MG * plan.curve(force / STANDARD_GRAVITY)
    return np.asarray(reading)


def code_steps(amplitude: float, period: float = 0.17) -> Callable[[Array], Array]:
    """A converter's saw-tooth non-linearity in mg against the reading in g, as at major codes."""

    def curve(reading: Array) -> Array:
        phase = np.mod(reading / period, 1.0)
        return np.asarray(amplitude * (2.0 * np.abs(2.0 * phase - 1.0) - 1.0))

    return curve


def simulated_blocks(
    plan: simulation.WeekPlan, seed: int, *, block: float = 3600.0
) -> Iterator[Recording]:
    """Rests and movements of the sensor alone, in blocks of `block` seconds."""
    rng = np.random.default_rng(seed)
    model, theta = plant_model(plan.sensor, Context(1))
    at_zero = model.predict(theta, np.zeros((1, 1, 3)), Context(1))
    offset, reach = at_zero.reading[0, 0], at_zero.d_truth[0, 0]
    per = round(plan.rate * POSTURE)
    for start in np.arange(0.0, plan.days * DAY, block):
        n = round(min(block, plan.days * DAY - start) * plan.rate)
        count = n // per + 1
        still = np.repeat(postures(count, rng), per, axis=0)[:n] * plan.gravity
        moving = rng.random(count) > plan.rests
        shake = np.repeat(moving * 120.0 * MG, per)[:n, None]
        values = still @ reach.T + offset
        values += (shake + plan.noise * MG) * rng.standard_normal((n, 3))
        t = start + np.arange(n) / plan.rate
        channel = Channel(t, values, "m/s2", "acceleration", "imu0", plan.rate)
        yield Recording({"imu0/acceleration": channel}, "simulated", "simulated", "", 0)
