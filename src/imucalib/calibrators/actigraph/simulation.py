"""A simulated week on the wrist with planted effects, as a recording."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.planted import plant_model
from imucalib.core.effect import Context
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.thermal import REMEMBERED, ThermalHistory, remember
from imucalib.units import MG, STANDARD_GRAVITY

_DAY, _HOUR, _POSTURE = 86400.0, 3600.0, 120.0  # s
_SHAKE = 120.0 * MG  # of an axis while the sensor moves
#: An ordinary wrist sensor.
SENSOR = {
    "bias": (25.0, -40.0, 15.0),
    "scale": (0.03, -0.03, 0.015),
    "non_orthogonality": (0.012, -0.018, 0.009),
}


@dataclass(frozen=True)
class WeekPlan:
    """What to simulate.

    days : length; rests : share of the time at rest; noise : mg of one sample; rate : Hz
    plant : effect -> parameters; sensor : of the nine parameters; gravity : m/s²
    temperature : whether a thermometer records
    """

    days: float = 7.0
    rests: float = 0.6
    noise: float = 4.0
    rate: float = 100.0
    plant: dict[str, tuple[float, ...]] = field(default_factory=dict)
    temperature: bool = True
    sensor: dict[str, tuple[float, ...]] = field(default_factory=lambda: dict(SENSOR))
    gravity: float = STANDARD_GRAVITY


def worn_blocks(plan: WeekPlan, seed: int) -> Iterator[Recording]:
    """An hour at a time: a posture of two minutes after the other, still or in movement, read by
    the planted sensor. Raises UsageError for an effect that cannot be planted."""
    rng = np.random.default_rng(seed)
    seconds = plan.days * _DAY
    grid = np.arange(5.0, seconds + 60.0, 60.0)
    warm = temperature_at(grid, seed)
    history = ThermalHistory(grid, warm)
    per = round(plan.rate * _POSTURE)
    for start in np.arange(0.0, seconds, _HOUR):
        t = start + np.arange(round(min(_HOUR, seconds - start) * plan.rate)) / plan.rate
        count = t.size // per + 1
        moving = np.repeat(rng.random(count) > plan.rests, per)[: t.size]
        force = plan.gravity * np.repeat(postures(count, rng), per, axis=0)[: t.size]
        force = force + _SHAKE * moving[:, None] * rng.standard_normal(force.shape)
        known = {
            "record": np.arange(t.size, dtype=np.float64),
            "time": t,
            "order": t / seconds,
            "time_of_day": 2.0 * np.pi * (t / _DAY % 1.0),
        }
        channels = {}
        if plan.temperature:
            now = np.interp(t, grid, warm)
            known |= {"temperature": now}
            known |= {name: remember(history, name, t) for name in REMEMBERED}
            thermometer = Channel(t, now[:, None], "degC", "temperature", "imu0", plan.rate)
            channels["imu0/temperature"] = thermometer
        context = Context(t.size, known)
        model, theta = plant_model({**plan.sensor, **plan.plant}, context)
        values = model.predict(theta, force[:, None], context).reading[:, 0]
        values = values + plan.noise * MG * rng.standard_normal(values.shape)
        sensor = Channel(t, values, "m/s2", "acceleration", "imu0", plan.rate)
        channels = {"imu0/acceleration": sensor, **channels}
        yield Recording(channels, "simulated", "simulated", "", 0)


def temperature_at(time: Array, rng_seed: int) -> Array:
    """°C on the wrist: a daily swing and non-wear in which the case cools within half an hour."""
    rng = np.random.default_rng(rng_seed)
    warm = 31.0 + 1.5 * np.sin(2.0 * np.pi * time / _DAY - 0.7)
    for start in rng.uniform(0.0, max(float(time[-1]), 1.0), 8):
        for at, sign in ((start, -1.0), (start + rng.uniform(1.0, 4.0) * _HOUR, 1.0)):
            since = np.clip((time - at) / 1800.0, 0.0, 40.0)
            warm = warm + sign * 6.0 * (1.0 - np.exp(-since))
    return np.asarray(warm)


def postures(n: int, rng: np.random.Generator) -> Array:
    """Unit vectors (n, 3) around two dozen habits of the wrist and a few from anywhere."""
    habits = rng.standard_normal((24, 3))
    weight = rng.dirichlet(np.full(24, 0.7))
    usual = habits[rng.choice(24, n, p=weight)]
    usual = usual / np.linalg.norm(usual, axis=1, keepdims=True)
    mixed = usual + 0.35 * rng.standard_normal((n, 3))
    anywhere = rng.random(n) < 0.05
    mixed[anywhere] = rng.standard_normal((int(anywhere.sum()), 3))
    return np.asarray(mixed / np.linalg.norm(mixed, axis=1, keepdims=True))
