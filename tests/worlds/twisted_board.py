"""A board that is twisted, calibrated perfectly but for its places, in plain numpy; and the joint
fit of it."""

from __future__ import annotations

import numpy as np

from imucalib.calibrators.array.board.board import Board, read_board
from imucalib.calibrators.array.board.moving import Moving, relative_gyros
from imucalib.calibrators.array.motion.setup import array_setup
from imucalib.calibrators.array.motion.state import ArrayState, start_state
from worlds.boards import DEG, BoardPlan, twisted

BOARD = read_board("mimu4444_corners")


def moved(
    plan: BoardPlan, rng: np.random.Generator, board: Board = BOARD, late: float = 0.0
) -> tuple[Moving, np.ndarray]:
    """The twisting part alone, calibrated perfectly, by numpy; and the true positions.

    late : s, by which all gyros are
    """
    true = board.drawn + rng.normal(size=board.drawn.shape) * plan.places
    true -= true[0]
    w, spin, force = twisted(plan, rng)
    n, k = len(w), board.count
    felt = force[:, None] + np.cross(w[:, None], np.cross(w[:, None], true))
    felt = felt + np.cross(spin[:, None], true)
    noise = rng.normal(size=(2, n, k, 3))
    if np.isfinite(plan.tails):
        noise /= np.sqrt(rng.chisquare(plan.tails, (2, n, k, 1)) / plan.tails)
    rate = (w - late * spin)[:, None] + noise[1] * plan.sigma_gyro * DEG
    good = np.flatnonzero(np.linalg.norm(w, axis=1) > 200.0 * DEG)
    t = np.arange(n) / plan.hz
    gyros = relative_gyros(rate, good)
    return Moving(t, felt + noise[0] * plan.sigma, rate, gyros, good, 1.0 / plan.hz, {}), true


def fitted(
    plan: BoardPlan, seed: int, samples: int, board: Board = BOARD, late: float = 0.0
) -> tuple[ArrayState, np.ndarray]:
    """The state before any search, and the true positions."""
    moving, true = moved(plan, np.random.default_rng(seed), board, late)
    setup = array_setup(moving, board, samples)
    assert setup is not None
    return start_state(setup, ()), true
