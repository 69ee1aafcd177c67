"""Simulated benches: positions, readings and rests are those that were asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibrators.lab import simulation
from imucalib.calibrators.lab.simulation import BenchPlan
from imucalib.core.context import Context
from imucalib.core.observations import Observations
from imucalib.core.references import KnownVector
from imucalib.errors import UsageError
from imucalib.units import DEG, MG
from worlds.sheets import direction

G = 9.80665


def test_a_simulated_sheet_reads_its_sensor_with_the_noise_asked_for() -> None:
    plan = BenchPlan(positions=400, layout="rings", noise=1.5, setting=(0.0, 0.0),
                     plant={"quadratic": (3.0, 0.0, 0.0)}, slips=((7, "y"),))  # fmt: skip
    table = simulation.simulated_table(plan, np.random.default_rng(1))
    i, t = (np.radians(table.columns[n]) for n in ("inclination", "tool_face"))
    ids = np.arange(400)
    reference = KnownVector(i, t, G, ids, ids)
    data = Observations(np.zeros((400, 1, 3)), np.ones((400, 1, 3)), reference, Context(400), ids,
                        ("",) * 400)  # fmt: skip
    clean = simulation.planted_truth(plan, data, G * direction(np.rad2deg(i), np.rad2deg(t))) / MG
    off = table.raw() - clean
    assert off[6, 1] == pytest.approx(-2.0 * clean[6, 1], abs=8.0)
    off[6, 1] = 0.0
    np.testing.assert_allclose(off.std(axis=0), 1.5, rtol=0.1)
    warm = simulation.simulated_table(replace(plan, temperature=(10.0, 40.0), slips=()),
                                      np.random.default_rng(1))  # fmt: skip
    np.testing.assert_allclose(warm.columns["temperature"], np.linspace(10.0, 40.0, 400))
    wide = simulation.simulated_table(
        replace(plan, noise=1e-6, setting=(0.3, 0.0), plant={}, slips=()), np.random.default_rng(2)
    )
    sheet = simulation.simulated_table(
        replace(plan, noise=1e-6, setting=(0.0, 0.0), plant={}, slips=()), np.random.default_rng(2)
    )
    moved = np.linalg.norm(wide.raw() - sheet.raw(), axis=1) / 1000.0 / DEG
    # Each of three rings and two poles is set once.
    assert len(np.unique(np.round(moved, 2))) <= 8
    with pytest.raises(UsageError, match="no such cell"):
        simulation.simulated_table(replace(plan, slips=((401, "y"),)), np.random.default_rng(1))


def test_a_simulated_recording_rests_and_moves_in_turn() -> None:
    """Four seconds in each position, 1.5 s of motion between, from one to the next without a
    jump."""
    plan = BenchPlan(positions=12, noise=1e-6)
    table = simulation.simulated_table(plan, np.random.default_rng(0))
    made = simulation.simulated_recording(table, np.random.default_rng(0), noise=2.0)
    channel = made.channels["imu0/acceleration"]
    assert len(channel.t) == 12 * 400 + 11 * 150
    np.testing.assert_allclose(np.diff(channel.t), 0.01)
    for k in range(12):
        rest = channel.values[550 * k : 550 * k + 400] / MG
        np.testing.assert_allclose(rest.mean(axis=0), table.raw()[k], atol=0.6)
        np.testing.assert_allclose(rest.std(axis=0), 2.0, rtol=0.15)
        if k < 11:
            motion = channel.values[550 * k + 400 : 550 * k + 550] / MG
            half = motion[65:85].mean(axis=0)
            np.testing.assert_allclose(half, table.raw()[k : k + 2].mean(axis=0), atol=45.0)
            assert 30.0 < (motion[60:90] - _even(motion[60:90])).std() < 50.0
            np.testing.assert_allclose(motion[0], table.raw()[k], atol=12.0)


def _even(values: np.ndarray) -> np.ndarray:
    """The straight line through values (n, 3)."""
    at = np.arange(len(values))
    return np.stack([np.polyval(np.polyfit(at, v, 1), at) for v in values.T], axis=1)
