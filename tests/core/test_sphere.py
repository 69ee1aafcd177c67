"""Directions spread evenly: moments of the uniform sphere, and no two near each other."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.core.sphere import even_directions


@pytest.mark.parametrize("n", [60, 400])
def test_directions_are_spread_evenly(n: int) -> None:
    u = even_directions(n)
    np.testing.assert_allclose(np.linalg.norm(u, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(u.mean(axis=0), 0.0, atol=1.0 / n)
    np.testing.assert_allclose(u.T @ u / n, np.eye(3) / 3.0, atol=2.0 / n)
    apart = np.arccos(np.clip(u @ u.T - 2.0 * np.eye(n), -1.0, 1.0)).min(axis=1)
    own = np.sqrt(4.0 * np.pi / n)  # side of the square that each has for itself
    assert apart.min() > 0.8 * own
    assert apart.max() < 1.2 * own
