"""How well a set of positions is conditioned, against its matrix written a second time."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.calibrators.lab.design import judge, uniform_directions
from imucalib.core.context import Context
from imucalib.core.model import Model
from imucalib.effects import named
from worlds.sheets import direction


def test_the_condition_is_that_of_the_norms_columns() -> None:
    """d|y| of bias, scale and cross terms (docs/effects.md) at f, a typical size of each."""
    rng = np.random.default_rng(4)
    i, t = rng.uniform(-80.0, 80.0, 30), rng.uniform(0.0, 360.0, 30)
    f = direction(i, t)
    x, y, z = f.T
    columns = np.stack([x, y, z, x * x, y * y, z * z, y * x, z * x, z * y], axis=-1)
    model = Model(tuple(named(n) for n in ("bias", "scale", "non_orthogonality")))
    typical = np.array([p.typical for p in model.parameters(Context(1))])
    unit = np.array([1e-3] * 3 + [1.0] * 6)  # mg in g
    values = np.linalg.svd(columns * typical * unit, compute_uv=False)
    found = judge(model, np.deg2rad(i), np.deg2rad(t), norm=True)
    assert found.condition == pytest.approx(values[0] / values[-1], rel=1e-6)


def test_the_lattice_turns_by_the_golden_ratio() -> None:
    i, t = uniform_directions(200)
    k = np.arange(200) + 0.5
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    np.testing.assert_allclose(np.sin(i), 1.0 - k / 100.0, atol=1e-12)
    away = np.mod(t - 2.0 * np.pi * golden * k + np.pi, 2.0 * np.pi) - np.pi
    np.testing.assert_allclose(away, 0.0, atol=1e-9)
