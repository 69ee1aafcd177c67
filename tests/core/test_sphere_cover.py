"""How much of the sphere postures cover: what a held-out error holds for."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.core.sphere import covered, even_directions


def test_the_share_is_that_of_caps() -> None:
    """A cap of half angle a is (1 - cos a) / 2 of the sphere; opposite ones do not overlap."""
    one = covered(np.array([[0.0, 0.0, 9.8]]), within=40.0)
    assert one == pytest.approx(0.5 * (1.0 - np.cos(np.radians(40.0))), abs=0.01)
    two = covered(np.array([[0.0, 0.0, 9.8], [0.0, 0.0, -1.0]]), within=40.0)
    assert two == pytest.approx(2.0 * one, abs=0.01)
    assert covered(even_directions(200)) == 1.0
