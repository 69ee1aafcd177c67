"""Where a fit starts: the turns of a matrix, put together again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imucalib.estimators.starting_point import _turns


def about(axis: int, angle: float) -> NDArray[np.float64]:
    """A turn of the right hand about x, y or z."""
    out = np.eye(3)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    out[a, a] = out[b, b] = np.cos(angle)
    out[b, a], out[a, b] = np.sin(angle), -np.sin(angle)
    return out


def test_turns_are_those_about_x_then_y_then_z() -> None:
    rng = np.random.default_rng(0)
    for x, y, z in rng.uniform(-1.4, 1.4, (20, 3)):
        np.testing.assert_allclose(_turns(about(2, z) @ about(1, y) @ about(0, x)), [x, y, z])
