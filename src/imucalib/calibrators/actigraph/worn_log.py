"""A worn sensor's recording sample by sample, with planted effects: rests, movements, warmth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.actigraph.simulation import (
    WeekPlan,
    planted,
    postures,
    scan_of,
    temperature_at,
)
from imucalib.core.context import Context
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.thermal import REMEMBERED, ThermalHistory, history_of, remembered
from imucalib.units import MG

_DAY, _POSTURE, _HOUR = 86400.0, 120.0, 3600.0  # s
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
        seconds = self.plan.days * _DAY
        found = {
            "record": np.arange(t.size, dtype=np.float64),
            "time": t,
            "order": t / seconds,
            "time_of_day": 2.0 * np.pi * (t / _DAY % 1.0),
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
    seconds = plan.days * _DAY
    grid = np.arange(5.0, seconds + 60.0, 60.0)
    warm = temperature_at(grid, seed)
    windows = scan_of(grid, warm, rate=plan.rate, seconds=seconds).temperature
    assert windows is not None
    world = _World(plan, grid, warm, history_of(windows))
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
        channels["imu0/temperature"] = Channel(
            t, warm, "degC", "temperature", "imu0", plan.rate
        )  # fmt: skip
    return Recording(channels, "simulated", "simulated", "", 0)
