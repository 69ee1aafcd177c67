"""What readings of one power-up share, and that one power-up alone shares nothing that shows."""

from __future__ import annotations

import numpy as np

from imucalib.core.observations import BIAS, MOUNTING, session_of, turned, with_sessions
from worlds.bench import bench, tumble

SESSION = np.array([0, 0, 1, 1, 2, 2]).repeat(10)


def test_each_session_is_a_level_of_its_components() -> None:
    found = with_sessions(bench(1), SESSION)
    bias, mounting = found.shared[:2]
    assert (bias.name, mounting.name) == (BIAS, MOUNTING)
    expected = (SESSION[:, None] == np.arange(3)).astype(float)
    for one in (bias, mounting):
        np.testing.assert_array_equal(one.factor, expected)
    np.testing.assert_array_equal(session_of(found), SESSION)


def test_norms_know_no_turn_of_the_seat() -> None:
    assert [one.name for one in with_sessions(tumble(1), SESSION).shared] == [BIAS]


def test_one_session_has_nothing_to_tell() -> None:
    data = bench(1)
    assert with_sessions(data, np.zeros(60, np.intp)) is data
    assert session_of(data) is None


def test_a_small_turn_is_a_cross_product() -> None:
    reading = np.random.default_rng(0).standard_normal((7, 3))
    for turn in np.eye(3):
        np.testing.assert_allclose(turned(reading) @ turn, np.cross(turn, reading), atol=1e-12)
