"""What readings of one power-up share, and that one power-up alone shares nothing that shows."""

from __future__ import annotations

import numpy as np

from imucalib.core.observations import BIAS, MOUNTING, session_of, with_sessions
from worlds.bench import bench

SESSION = np.array([0, 0, 1, 1, 2, 2]).repeat(10)


def test_each_session_is_a_level_of_its_components() -> None:
    found = with_sessions(bench(1), SESSION)
    bias, mounting = found.shared[:2]
    assert (bias.name, mounting.name) == (BIAS, MOUNTING)
    expected = (SESSION[:, None] == np.arange(3)).astype(float)
    for one in (bias, mounting):
        np.testing.assert_array_equal(one.factor, expected)
    np.testing.assert_array_equal(session_of(found), SESSION)
