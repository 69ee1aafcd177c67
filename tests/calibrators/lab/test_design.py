"""How well a set of positions is conditioned, against its matrix written a second time."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.calibrators.lab.design import judge, uniform_directions
from imucalib.core.context import Context
from imucalib.core.model import Model
from imucalib.effects import named
from worlds.sheets import direction

MODEL = Model(tuple(named(n) for n in ("bias", "scale", "non_orthogonality")))


def columns(i: np.ndarray, t: np.ndarray) -> np.ndarray:
    """d|y| of bias, scale and cross terms (docs/effects.md) at f, a typical size of each, in g."""
    x, y, z = direction(i, t).T
    unit = np.array([1e-3] * 3 + [1.0] * 6)  # mg in g
    typical = np.array([p.typical for p in MODEL.parameters(Context(1))])
    every = (x, y, z, x * x, y * y, z * z, y * x, z * x, z * y)
    return np.stack(every, axis=-1) * typical * unit


def test_the_condition_is_that_of_the_norms_columns() -> None:
    rng = np.random.default_rng(4)
    i, t = rng.uniform(-80.0, 80.0, 30), rng.uniform(0.0, 360.0, 30)
    values = np.linalg.svd(columns(i, t), compute_uv=False)
    found = judge(MODEL, np.deg2rad(i), np.deg2rad(t), norm=True)
    assert found.condition == pytest.approx(values[0] / values[-1], rel=1e-6)


def test_the_lattice_turns_by_the_golden_ratio() -> None:
    i, t = uniform_directions(200)
    k = np.arange(200) + 0.5
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    np.testing.assert_allclose(np.sin(i), 1.0 - k / 100.0, atol=1e-12)
    away = np.mod(t - 2.0 * np.pi * golden * k + np.pi, 2.0 * np.pi) - np.pi
    np.testing.assert_allclose(away, 0.0, atol=1e-9)


@pytest.mark.parametrize("pole", [-90.0, 90.0])
def test_the_position_that_tells_most_is_offered(pole: float) -> None:
    """Of all on a grid of 15 deg, both poles with it: the largest determinant, one pole here."""
    rng = np.random.default_rng(1)
    i, t = -np.sign(pole) * rng.uniform(-20.0, 80.0, 300), rng.uniform(0.0, 360.0, 300)
    grid = [(a, b) for a in np.arange(-75.0, 76.0, 15.0) for b in np.arange(0.0, 360.0, 15.0)]
    grid += [(-90.0, 0.0), (90.0, 0.0)]
    known = columns(i, t).T @ columns(i, t)
    offered = columns(*np.array(grid).T)
    worth = [np.linalg.slogdet(known + np.outer(row, row))[1] for row in offered]
    assert grid[int(np.argmax(worth))] == (pole, 0.0)
    first = judge(MODEL, np.deg2rad(i), np.deg2rad(t), norm=True).additions[0]
    assert first.inclination == pytest.approx(pole)
