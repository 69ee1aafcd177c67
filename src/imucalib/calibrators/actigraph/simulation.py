"""A simulated week on the wrist with planted effects, as windows, as runs or as a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.actigraph.observations import NINE, covariates_of
from imucalib.core.effect import Context
from imucalib.core.model import Model
from imucalib.effects import named
from imucalib.errors import UsageError
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.runs import PostureRuns, Scan
from imucalib.rests.thermal import REMEMBERED, ThermalHistory, remembered
from imucalib.rests.windows import Windows
from imucalib.units import MG, STANDARD_GRAVITY

_DAY_S, _POSTURE, _HOUR = 86400.0, 120.0, 3600.0  # s
_SHAKE = 120.0 * MG  # of an axis while the sensor moves


@dataclass(frozen=True)
class _World:
    """Warmth of the days and what the effects may depend on."""

    plan: WeekPlan
    grid: Array
    warm: Array
    history: ThermalHistory

    def context(self, t: Array) -> Context:
        """Of samples at times t (n,) s; nothing remembers the reading before."""
        seconds = self.plan.days * _DAY_S
        found = {
            "record": np.arange(t.size, dtype=np.float64),
            "time": t,
            "order": t / seconds,
            "time_of_day": 2.0 * np.pi * (t / _DAY_S % 1.0),
        }
        if self.plan.temperature:
            found["temperature"] = self.temperature(t)
            found |= {name: remembered(self.history, name, t) for name in REMEMBERED}
        return Context(t.size, found)

    def temperature(self, t: Array) -> Array:
        return np.interp(t, self.grid, self.warm)


def worn_blocks(plan: WeekPlan, seed: int) -> Iterator[Recording]:
    """An hour at a time: a posture of two minutes after the other, still or in movement, read by
    the planted sensor. Raises UsageError for an effect that cannot be planted."""
    rng = np.random.default_rng(seed)
    seconds = plan.days * _DAY_S
    grid = np.arange(5.0, seconds + 60.0, 60.0)
    warm = temperature_at(grid, seed)
    world = _World(plan, grid, warm, ThermalHistory(grid, warm))
    for start in np.arange(0.0, seconds, _HOUR):
        n = round(min(_HOUR, seconds - start) * plan.rate)
        yield _block(world, start + np.arange(n) / plan.rate, rng)


def _block(world: _World, t: Array, rng: np.random.Generator) -> Recording:
    plan = world.plan
    per = round(plan.rate * _POSTURE)
    count = t.size // per + 1
    moving = np.repeat(rng.random(count) > plan.rests, per)[: t.size]
    force = plan.gravity * np.repeat(postures(count, rng), per, axis=0)[: t.size]
    force = force + _SHAKE * moving[:, None] * rng.standard_normal(force.shape)
    context = world.context(t)
    model, theta = planted(plan, context)
    values = model.predict(theta, force[:, None], context).reading[:, 0]
    values = values + plan.noise * MG * rng.standard_normal(values.shape)
    channels = {"imu0/acceleration": Channel(t, values, "m/s2", "acceleration", "imu0", plan.rate)}
    if plan.temperature:
        warm = world.temperature(t)[:, None]
        channels["imu0/temperature"] = Channel(t, warm, "degC", "temperature", "imu0", plan.rate)
    return Recording(channels, "simulated", "simulated", "", 0)


#: An ordinary wrist sensor.
SENSOR = {
    "bias": (25.0, -40.0, 15.0),
    "scale": (0.03, -0.03, 0.015),
    "non_orthogonality": (0.012, -0.018, 0.009),
}
_DAY = 86400.0
_RUN_S = 120.0  # mean length of a posture at rest


@dataclass(frozen=True)
class WeekPlan:
    """What to simulate.

    days : length; rests : share of the time at rest; noise : mg of one sample; rate : Hz
    scatter : mg, norm error that all windows of a posture share
    plant : effect -> parameters; steps : (time in s, mg on x, y, z); curve : per axis, reading in g
        -> mg, a converter's own non-linearity
    temperature : whether a thermometer records
    """

    days: float = 7.0
    rests: float = 0.6
    noise: float = 4.0
    rate: float = 100.0
    scatter: float = 0.4
    plant: dict[str, tuple[float, ...]] = field(default_factory=dict)
    curve: Callable[[Array], Array] | None = None
    temperature: bool = True
    sensor: dict[str, tuple[float, ...]] = field(default_factory=lambda: dict(SENSOR))
    gravity: float = STANDARD_GRAVITY


@dataclass(frozen=True)
class Week:
    """Simulated runs with the scan that they would come from, and the true specific force (n, 3)
    m/s², without noise, in the frame that keeps x."""

    runs: PostureRuns
    scanned: Scan
    force: Array
    plan: WeekPlan


def temperature_at(time: Array, rng_seed: int) -> Array:
    """°C on the wrist: a daily swing and non-wear in which the case cools within half an hour."""
    rng = np.random.default_rng(rng_seed)
    warm = 31.0 + 1.5 * np.sin(2.0 * np.pi * time / _DAY - 0.7)
    for start in rng.uniform(0.0, max(float(time[-1]), 1.0), 8):
        for at, sign in ((start, -1.0), (start + rng.uniform(1.0, 4.0) * 3600.0, 1.0)):
            since = np.clip((time - at) / 1800.0, 0.0, 40.0)
            warm = warm + sign * 6.0 * (1.0 - np.exp(-since))
    return np.asarray(warm)


def simulated_week(plan: WeekPlan, seed: int) -> Week:
    """Posture runs as detection would give them, without making every sample."""
    rng = np.random.default_rng(seed)
    seconds = plan.days * _DAY
    n = max(12, int(plan.rests * seconds / _RUN_S))
    time = np.sort(rng.uniform(0.0, seconds, n))
    windows = 1 + rng.geometric(10.0 / _RUN_S, n)
    direction = postures(n, rng)
    grid = np.arange(5.0, seconds, 60.0)
    warm = temperature_at(grid, seed)
    scanned = scan_of(grid, warm if plan.temperature else None, rate=plan.rate, seconds=seconds)
    temperature = np.interp(time, grid, warm) if plan.temperature else np.full(n, np.nan)
    window_noise = plan.noise * MG / np.sqrt(10.0 * plan.rate)
    blank = PostureRuns(
        mean=plan.gravity * direction,
        windows=windows.astype(np.intp),
        time=time,
        temperature=temperature,
        window_noise=window_noise,
        still=int(windows.sum()),
        total=int(seconds / 10.0),
        noise=np.full(3, plan.noise * MG),
    )
    force = plan.gravity * direction
    reading = sensed(plan, force, blank, scanned)
    spread = np.sqrt((plan.scatter * MG) ** 2 + window_noise**2 / windows)
    reading = reading + spread[:, None] * rng.standard_normal((n, 3))
    return Week(replace(blank, mean=reading), scanned, force, plan)


def postures(n: int, rng: np.random.Generator) -> Array:
    """Unit vectors (n, 3) around two dozen habits of the wrist and a few from anywhere."""
    habits = rng.standard_normal((24, 3))
    weight = rng.dirichlet(np.full(24, 0.7))
    near = habits[rng.choice(24, n, p=weight)]
    near = near / np.linalg.norm(near, axis=1, keepdims=True)
    mixed = near + 0.35 * rng.standard_normal((n, 3))
    anywhere = rng.random(n) < 0.05
    mixed[anywhere] = rng.standard_normal((int(anywhere.sum()), 3))
    return np.asarray(mixed / np.linalg.norm(mixed, axis=1, keepdims=True))


def sensed(plan: WeekPlan, force: Array, runs: PostureRuns, scanned: Scan) -> Array:
    """Noise-free readings (n, 3) of the planted sensor at specific forces (n, 3), m/s²."""
    context = Context(runs.n, covariates_of(runs, scanned))
    model, theta = planted(plan, context)
    reading = model.predict(theta, force[:, None], context).reading[:, 0]
    if plan.curve is not None:
        reading = reading + MG * plan.curve(force / STANDARD_GRAVITY)
    return np.asarray(reading)


def planted(plan: WeekPlan, context: Context) -> tuple[Model, Array]:
    """The planted model and its θ. Raises UsageError for a wrong number of parameters."""
    names = (*NINE, *(name for name in plan.plant if name not in NINE))
    model = Model(tuple(named(name) for name in names))
    theta, slices = model.start(context), model.slices(context)
    for name, values in {**plan.sensor, **plan.plant}.items():
        part = slices[name]
        if len(values) != part.stop - part.start:
            raise UsageError(f"{name} has {part.stop - part.start} parameters, not {len(values)}")
        theta[part] = values
    return model, theta


def scan_of(grid: Array, warm: Array | None, *, rate: float, seconds: float) -> Scan:
    """A scan that no samples made: its thermometer reads `warm` (t,) in °C at `grid` (t,) in s."""
    nothing = np.zeros((0, 3))
    empty = Windows(
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
    )
    return Scan(
        windows=empty,
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


def code_steps(amplitude: float, period: float = 0.17) -> Callable[[Array], Array]:
    """A converter's saw-tooth non-linearity in mg against the reading in g, as at major codes."""

    def curve(reading: Array) -> Array:
        phase = np.mod(reading / period, 1.0)
        return np.asarray(amplitude * (2.0 * np.abs(2.0 * phase - 1.0) - 1.0))

    return curve


def simulated_blocks(plan: WeekPlan, seed: int, *, block: float = 3600.0) -> Iterator[Recording]:
    """The same kind of week sample by sample, in blocks of `block` seconds: rests and movements."""
    rng = np.random.default_rng(seed)
    rate, seconds = plan.rate, plan.days * _DAY
    model, theta = planted(replace(plan, plant={}), Context(1))
    offset = model.predict(theta, np.zeros((1, 1, 3)), Context(1)).reading[0, 0]
    reach = model.predict(theta, np.zeros((1, 1, 3)), Context(1)).d_truth[0, 0]
    per = round(rate * _RUN_S)
    for start in np.arange(0.0, seconds, block):
        n = round(min(block, seconds - start) * rate)
        count = n // per + 1
        hold = postures(count, rng)
        moving = rng.random(count) > plan.rests
        still = np.repeat(hold, per, axis=0)[:n] * plan.gravity
        shake = np.repeat(moving * 120.0 * MG, per)[:n, None]
        values = still @ reach.T + offset
        values += (shake + plan.noise * MG) * rng.standard_normal((n, 3))
        t = start + np.arange(n) / rate
        channel = Channel(t, values, "m/s2", "acceleration", "imu0", rate)
        yield Recording({"imu0/acceleration": channel}, "simulated", "simulated", "", 0)
