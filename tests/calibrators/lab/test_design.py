"""Plans of positions, and benches that are simulated by them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucalib.calibrators.lab import simulation
from imucalib.calibrators.lab.design import (
    design_of,
    judge,
    recommend,
)
from imucalib.calibrators.lab.simulation import BenchPlan
from imucalib.core.angle_conventions import PRESETS
from imucalib.core.effect import Context
from imucalib.core.model import Model
from imucalib.core.references import angles_of
from imucalib.core.sphere import even_directions
from imucalib.effects import named
from imucalib.errors import UsageError
from worlds.sheets import direction

MODEL = Model(tuple(named(n) for n in ("bias", "scale", "non_orthogonality")))


def columns(i: np.ndarray, t: np.ndarray) -> np.ndarray:
    """d|y| of bias, scale and cross terms (docs/effects.md) at f, a typical size of each, in g."""
    x, y, z = direction(i, t).T
    unit = np.array([1e-3] * 3 + [1.0] * 6)  # mg in g
    typical = np.array([p.typical for p in MODEL.parameters(Context(1))])
    every = (x, y, z, x * x, y * y, z * z, y * x, z * x, z * y)
    return np.stack(every, axis=-1) * typical * unit


def scaled(i: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Information of positions for 1 mg of noise: `columns` are in g."""
    return 1e6 * columns(i, t).T @ columns(i, t)


def test_efficiency_sd_and_gain_are_those_of_the_information() -> None:
    """D-efficiency: the root of the determinant's share of a uniform sphere's, per reading."""
    rng = np.random.default_rng(4)
    i, t = rng.uniform(-80.0, 80.0, 30), rng.uniform(0.0, 360.0, 30)
    found = judge(MODEL, np.deg2rad(i), np.deg2rad(t), norm=True)
    known, sphere = scaled(i, t), scaled(*np.rad2deg(angles_of(even_directions(4000))))
    share = np.linalg.slogdet(known / 30.0)[1] - np.linalg.slogdet(sphere / 4000.0)[1]
    assert found.efficiency == pytest.approx(np.exp(share / 9.0), rel=1e-6)
    sd = np.sqrt(np.diag(np.linalg.inv(known)))
    typical = np.array([p.typical for p in MODEL.parameters(Context(1))])
    np.testing.assert_allclose(found.sd, sd * typical, rtol=1e-6)
    assert found.positions == 30

    more, count = known, 30
    for added in found.additions:
        before = np.sqrt(np.diag(np.linalg.inv(more)))
        more = more + scaled(*np.array([[added.inclination], [added.tool_face]]))
        count += 1
        gain = before / np.sqrt(np.diag(np.linalg.inv(more)))
        assert added.gain == pytest.approx(gain.max(), rel=1e-6)
        assert added.parameter == found.names[int(np.argmax(gain))]
        share = np.linalg.slogdet(more / count)[1] - np.linalg.slogdet(sphere / 4000.0)[1]
        assert added.efficiency == pytest.approx(np.exp(share / 9.0), rel=1e-6)
    assert len(found.additions) == 2


def test_a_plan_is_judged_in_the_users_convention() -> None:
    """Drilling counts inclination from the vertical and tool-face from -y."""
    i, t = recommend(20)
    own = PRESETS["drilling-gravity"].outside(i, t)
    found = design_of(*own, PRESETS["drilling-gravity"])
    np.testing.assert_allclose(own[0], 90.0 - np.rad2deg(i))
    assert found.norm.efficiency == pytest.approx(judge(MODEL, i, t, norm=True).efficiency)
    assert len(found.vector.names) == 12
    assert found.vector.efficiency > found.norm.efficiency


def test_a_simulated_sheet_reads_its_sensor_with_the_noise_asked_for() -> None:
    """An ordinary triad by hand: lower triangle times mounting (about x, then y, then z), bias."""
    plan = BenchPlan(positions=400, layout="rings", noise=1.5, setting=(0.0, 0.0),
                     plant={"quadratic": (3.0, 0.0, 0.0)}, slips=((7, "y"),))  # fmt: skip
    table = simulation.simulate_table(plan, np.random.default_rng(1))
    lower = np.array([[1.006, 0.0, 0.0], [0.003, 0.996, 0.0], [-0.002, 0.004, 1.009]])
    mounting = Rotation.from_euler("xyz", [0.4, -0.7, 1.1], degrees=True).as_matrix()
    u = direction(table.columns["inclination"], table.columns["tool_face"])
    clean = 1000.0 * u @ (lower @ mounting).T + [25.0, -18.0, 32.0]
    clean[:, 0] += 3.0 * (u @ mounting.T)[:, 0] ** 2
    off = table.raw() - clean
    assert off[6, 1] == pytest.approx(-2.0 * clean[6, 1], abs=8.0)
    off[6, 1] = 0.0
    np.testing.assert_allclose(off.mean(axis=0), 0.0, atol=0.3)
    np.testing.assert_allclose(off.std(axis=0), 1.5, rtol=0.1)
    with pytest.raises(UsageError, match="no such cell"):
        simulation.simulate_table(replace(plan, slips=((401, "y"),)), np.random.default_rng(1))
