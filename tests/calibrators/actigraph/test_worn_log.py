"""A simulated log of a worn sensor: how much it rests, and that what is planted is what is read."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibrators.actigraph.simulation import WeekPlan, worn_blocks
from imucalib.units import MG

PLAN = WeekPlan(days=0.5, rests=0.6, noise=4.0, rate=0.5, temperature=True)


def values(plan: WeekPlan, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, readings and temperatures of all blocks."""
    blocks = list(worn_blocks(plan, seed))
    assert len(blocks) == 12
    found = [[b.channels[f"imu0/{q}"] for b in blocks] for q in ("acceleration", "temperature")]
    t, warm = found[0], found[1]
    assert all(np.array_equal(a.t, b.t) for a, b in zip(t, warm, strict=True))
    return (
        np.concatenate([c.t for c in t]),
        np.concatenate([c.values for c in t]),
        np.concatenate([c.values[:, 0] for c in warm]),
    )


def test_postures_of_two_minutes_at_rest_or_in_movement() -> None:
    ideal = replace(PLAN, sensor={"bias": (0.0,) * 3, "scale": (0.0,) * 3})
    t, read, _ = values(ideal)
    np.testing.assert_allclose(t, 2.0 * np.arange(21600))
    each = read.reshape(-1, 60, 3)  # two minutes
    scatter = each.std(axis=1) / MG
    still = scatter.max(axis=1) < 10.0
    assert still.mean() == pytest.approx(0.6, abs=0.07)
    assert scatter[still].mean() == pytest.approx(4.0, rel=0.02)
    assert scatter[~still].mean() == pytest.approx(np.hypot(120.0, 4.0), rel=0.02)
    size = np.linalg.norm(each[still].mean(axis=1), axis=1)
    np.testing.assert_allclose(size, ideal.gravity, atol=2.0 * MG)


def test_what_is_planted_is_added_by_its_equation() -> None:
    """Differences of two recordings of one seed: noise and postures fall out."""
    t, plain, warm = values(PLAN)
    day = 2.0 * np.pi * t / 86400.0
    by_hand = {
        "temperature_bias": ((1.0, 0.0, -2.0), (warm - 25.0)[:, None] * [1.0, 0.0, -2.0]),
        "bias_drift": ((5.0, 0.0, 3.0), (t / 43200.0 - 0.5)[:, None] * [5.0, 0.0, 3.0]),
        "time_of_day": (
            (3.0, 0.0, 0.0, 0.0, 0.0, 2.0),
            np.column_stack([3.0 * np.cos(day), 0.0 * day, 2.0 * np.sin(day)]),
        ),
    }
    for name, (theta, expected) in by_hand.items():
        with_it = values(replace(PLAN, plant={name: theta}))[1]
        np.testing.assert_allclose((with_it - plain) / MG, expected, atol=1e-6)


def test_a_planted_lag_follows_the_temperature_late() -> None:
    _, plain, warm = values(PLAN)
    late = values(replace(PLAN, plant={"thermal_lag@1h": (1.0, 0.0, 0.0)}))[1][:, 0] - plain[:, 0]
    # dx/dt = (T - x) / τ, from the first temperature, by steps of two seconds.
    x, follows = warm[0], np.empty(warm.size)
    for k, temperature in enumerate(warm):
        follows[k] = x
        x += (temperature - x) * 2.0 / 3600.0
    made = late / MG
    fit = np.polyfit(follows, made, 1)
    assert fit[0] == pytest.approx(1.0, abs=0.02)
    assert np.abs(made - np.polyval(fit, follows)).max() < 0.02 * np.ptp(follows)
