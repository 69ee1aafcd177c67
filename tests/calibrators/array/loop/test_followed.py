"""Of few gyros none is followed for good: one that the motion follows leaves nothing of itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibrators.array.board import Board
from imucalib.calibrators.array.loop.search import start_state
from imucalib.calibrators.array.loop.setup import array_setup
from imucalib.calibrators.array.loop.state import ArrayState, moved_motion, settled
from imucalib.calibrators.array.loop.terms import rest_terms
from imucalib.estimators.array.followed import power_apart
from worlds.array_stories import BOARD, moving_of
from worlds.boards import made_board
from worlds.odd_boards import PLAN, odd_log, plain

CORNERS = 9.5e-3 * np.array([(1, 1, 0.1), (-1, 1, -0.1), (-1, -1, 0.1), (1, -1, -0.1)])


def started(seed: int) -> ArrayState:
    """Four IMUs whose gyros are alike, but for their noise without any error."""
    four = Board("four", BOARD.imus[:4], CORNERS, BOARD.rotations[:4])
    plan, rng = replace(PLAN, mounting=0.0, gyro_gain=0.0), np.random.default_rng(seed)
    parts = made_board(four.positions, four.rotations, four.imus, plan, rng)
    moving, rests = moving_of(odd_log(parts, plain, plan, rng).recording, four)
    setup = array_setup(moving, four, 300, robust=True)
    assert setup is not None
    return start_state(setup, rest_terms(rests))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_gyro_that_is_followed_is_let_go(seed: int) -> None:
    """As where its errors were the least before the effects were known: it counted 1600 times as
    much as each of the others, for good, and its own noise was theirs."""
    state = started(seed)
    factor = np.array([1.15, 1.15, 1.15, 0.025])
    noise = state.noise[0], replace(state.noise[1], factor=factor)
    found = settled(moved_motion(replace(state, noise=noise)))
    np.testing.assert_allclose(found.noise[1].factor, 1.0, atol=0.15)
    np.testing.assert_allclose(found.r, state.r, atol=2e-5)


def test_noise_is_told_by_what_gyros_differ_by() -> None:
    rng, size = np.random.default_rng(0), np.array([1.0, 2.0, 0.5, 1.0])
    own = size[:, None] * rng.normal(size=(20000, 4, 3))
    for weight in (np.ones(4), np.array([0.0, 0.0, 0.0, 1.0])):
        motion = np.einsum("k,tki->ti", weight / weight.sum(), own)
        found = power_apart(own - motion[:, None])
        np.testing.assert_allclose(found, size**2, atol=0.12)
