"""Benches that never were: position tables and recordings with planted effects and slips."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.lab.bench import position_observations
from imucalib.calibrators.lab.design import recommend
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.calibrators.planted import plant_model
from imucalib.core.angle_conventions import Conventions
from imucalib.core.references import unit_vector
from imucalib.errors import UsageError
from imucalib.recording.recording import Channel, Recording
from imucalib.units import DEG, MG, STANDARD_GRAVITY

#: An ordinary MEMS triad: mounting in deg, bias in mg, scale, cross terms.
SENSOR = {
    "mounting": (0.4, -0.7, 1.1),
    "bias": (25.0, -18.0, 32.0),
    "scale": (0.006, -0.004, 0.009),
    "non_orthogonality": (0.003, -0.002, 0.004),
}


@dataclass(frozen=True)
class BenchPlan:
    """What to simulate.

    layout : "sweeps" (a meridian and two rings, as benches are worked), "rings" (spread well) or
        "random" (the rings' positions in random order, which separates what else is confounded)
    plant : effect -> its parameters; noise : mg of one reading; setting : deg, scatter of the
        inclination and the tool-face settings; slips : (row from 1, axis) whose sign is lost
    """

    layout: str = "sweeps"
    positions: int = 32
    plant: dict[str, tuple[float, ...]] = field(default_factory=dict)
    noise: float = 1.0
    setting: tuple[float, float] = (0.1, 0.2)
    slips: tuple[tuple[int, str], ...] = ()
    gravity: float = STANDARD_GRAVITY
    temperature: tuple[float, float] | None = None


def simulate_table(plan: BenchPlan, rng: np.random.Generator) -> PositionTable:
    """A position table in degrees and mg. Raises UsageError for impossible plans."""
    inclination, tool_face = _layout(plan, rng)
    columns = {"inclination": inclination, "tool_face": tool_face}
    if plan.temperature is not None:
        columns["temperature"] = np.linspace(*plan.temperature, plan.positions)
    rows = np.arange(1, plan.positions + 1)
    nominal = PositionTable(columns, {}, {}, rows, "simulated", "")
    meant = plan.gravity * unit_vector(*Conventions().inside(inclination, tool_face))
    data = position_observations(nominal, meant, Conventions(), plan.gravity, sigma=plan.noise * MG)
    model, theta = plant_model({**SENSOR, **plan.plant}, data.context)
    reference = data.reference
    eta = np.zeros(reference.eta_size)
    for sd, index in zip(plan.setting, reference.directions(eta).index.T, strict=True):
        used = np.unique(index)
        eta[used] = sd * DEG * rng.standard_normal(used.size)
    clean = model.predict(theta, reference.truth(eta), data.context).reading[:, 0]
    reading = (clean + data.sigma[:, 0] * rng.standard_normal(clean.shape)) / MG
    for row, axis in plan.slips:
        if axis not in "xyz" or not 1 <= row <= plan.positions:
            raise UsageError(f"slip {row}:{axis}: no such cell")
        reading[row - 1, "xyz".index(axis)] *= -1.0
    columns |= dict(zip("xyz", reading.T, strict=True))
    names = {r: f"{r}_mg" if r in "xyz" else r for r in columns}
    return PositionTable(columns, names, dict.fromkeys("xyz", "mg"), rows, "simulated", "")


def _layout(plan: BenchPlan, rng: np.random.Generator) -> tuple[Array, Array]:
    if plan.layout in ("rings", "random"):
        i, t = recommend(plan.positions)
        n = plan.positions
        order = rng.permutation(n) if plan.layout == "random" else np.arange(n)
        return np.round(i / DEG, 6)[order], np.round(t / DEG, 6)[order]
    if plan.layout != "sweeps" or plan.positions < 12:
        raise UsageError(
            f"layout '{plan.layout}' with {plan.positions} positions",
            remedy="sweeps (12 or more) or rings",
        )
    ring = (plan.positions - 10) // 2
    last = plan.positions - 10 - ring
    inclination = np.concatenate([np.arange(0.0, 91.0, 10.0), np.full(ring, 50.0), np.zeros(last)])
    steps = [360.0 * np.arange(1, n + 1) / (n + 1) for n in (ring, last)]
    return inclination, np.round(np.concatenate([np.zeros(10), steps[0], steps[1][::-1]]), 1)


def simulate_recording(
    table: PositionTable,
    rng: np.random.Generator,
    *,
    rate: float = 100.0,
    rest: float = 4.0,
    noise: float = 4.0,
) -> Recording:
    """A recording that rests in each position of a table in turn, with 1.5 s of motion between.

    noise : mg of one sample
    """
    readings = table.raw() * MG
    still, move = round(rest * rate), round(1.5 * rate)
    parts: list[Array] = []
    for k, reading in enumerate(readings):
        parts.append(np.broadcast_to(reading, (still, 3)))
        if k + 1 < len(readings):
            s = np.linspace(0.0, 1.0, move + 2)[1:-1, None]
            path = reading + (readings[k + 1] - reading) * (3.0 * s**2 - 2.0 * s**3)
            shake = 40.0 * MG * np.sin(np.pi * s) * rng.standard_normal((move, 3))
            parts.append(path + shake)
    values = np.concatenate(parts)
    values = values + noise * MG * rng.standard_normal(values.shape)
    t = np.arange(len(values)) / rate
    channel = Channel(t, values, "m/s2", "acceleration", "imu0", rate)
    return Recording({"imu0/acceleration": channel}, "simulated", "simulated", "")
