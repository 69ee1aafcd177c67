"""The density that chains draw positions from is what the fit maximises, in its mode and shape."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibrators.array.calibrate import calibrate_array
from imucalib.calibrators.array.motion.covariance import add_unevenness
from imucalib.calibrators.array.motion.posterior import (
    PositionDensity,
    along,
    draw_positions,
    rank_directions,
    refuse_open,
)
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.errors import Undetermined
from imucalib.estimators.markov import Stop
from worlds.boards import DEG, Array, BoardPlan, board_log, made_board
from worlds.twisted_board import BOARD, fitted, moved

ONE = (0.7, 0.7, 0.14)
OTHER = (0.2, -0.4, 0.9)


@pytest.mark.parametrize("tails", [3.0, np.inf])
def test_its_mode_is_the_fits_and_its_shape_the_curvatures(tails: float) -> None:
    state, _ = fitted(BoardPlan(twist_s=6.0, tails=tails), 3, 450)
    state = add_unevenness(state)[0]
    d = state.positions
    found = draw_positions(state, Stop(), np.random.default_rng(0))
    assert found.accepted > 0.75
    assert found.convergence.bulk.min() >= 400.0
    sd = np.sqrt(np.diag(state.covariance)[:d])
    assert np.abs((found.mean - state.r)[1:].ravel() / sd).max() < 0.1
    assert state.by_noise is not None
    ratio = np.diag(found.covariance) / np.diag(state.by_noise)[:d]
    assert np.sqrt(ratio) == pytest.approx(np.ones(d), abs=0.15)


def test_it_is_the_least_squares_of_every_samples_motion() -> None:
    """Differences between positions, of plain noise, against scipy sample by sample."""
    plan, seed = BoardPlan(twist_s=2.0), 5
    state, _ = fitted(plan, seed, 60)
    state = add_unevenness(state)[0]
    rng = np.random.default_rng(0)
    density, rows = PositionDensity(state), state.setup.rows[state.setup.inner]
    # In units of the noise as it was made.
    a, g = (noise.sigma for noise in state.noise)
    noise = replace(plan, sigma=a, sigma_gyro=g / DEG)
    steps = 3e-5 * rng.normal(size=(2, state.positions))
    levels = []
    for step in (np.zeros(state.positions), *steps):
        r = state.r.copy()
        r[1:] += step.reshape(-1, 3)
        off = (r - BOARD.drawn)[1:].ravel() / BOARD.prior_sd
        levels.append(_squares(r, plan, seed, rows, noise) - 0.5 * off @ off)
    want = np.array(levels[1:]) - levels[0]
    assert density(steps) == pytest.approx(want, rel=2e-3)


def _squares(r: Array, made: BoardPlan, seed: int, rows: Array, noise: BoardPlan) -> float:
    from scipy.optimize import least_squares

    moving, _ = moved(made, np.random.default_rng(seed))
    total = 0.0
    for y, g in zip(moving.acceleration[rows], moving.rate[rows], strict=True):

        def off(x: Array, y: Array = y, g: Array = g) -> Array:
            w, spin, s = x[:3], x[3:6] * 1e2, x[6:]
            force = s + np.cross(w, np.cross(w, r)) + np.cross(spin, r)
            both = (y - force) / noise.sigma, (g - w) / (noise.sigma_gyro * DEG)
            return np.concatenate([one.ravel() for one in both])

        start = np.concatenate([g.mean(axis=0), np.zeros(6)])
        total -= float(least_squares(off, start, xtol=1e-14, ftol=1e-14).cost)
    return total


def test_the_direction_that_a_motion_shows_worst_is_named_and_refused_where_it_stays_open() -> None:
    n = np.array([0.7, 0.7, 0.14]) / np.linalg.norm([0.7, 0.7, 0.14])
    one = 1e-10 * np.eye(3) + 4e-8 * np.outer(n, n)
    covariance = np.kron(np.eye(7), one)
    sd, axes = rank_directions(covariance)
    assert sd[-1] == pytest.approx(2e-4, rel=0.01)
    assert along(axes[:, -1]) == "along (0.70, 0.70, 0.14) of the board"
    drawn = BOARD.drawn
    refuse_open(drawn, covariance, BOARD)
    with pytest.raises(Undetermined, match=r"along \(0\.70, 0\.70, 0\.14\) of the board to 53 %"):
        refuse_open(drawn, covariance * 8.0**2, BOARD)


@pytest.mark.slow
@pytest.mark.parametrize("about", [(ONE,), (ONE, OTHER)])
def test_boards_that_are_twisted_about_few_axes_hold_what_they_state(
    about: tuple[tuple[float, float, float], ...],
) -> None:
    axes = tuple(tuple(np.array(a) / np.linalg.norm(a)) for a in about)
    plan = BoardPlan(twist_s=12.0, rest_s=2.2, sigma=0.03, sigma_gyro=0.15, tails=5.0, about=axes)
    square = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        parts = made_board(BOARD.positions[::2], BOARD.rotations[::2], BOARD.imus[::2], plan, rng)
        log = board_log(parts, plan, rng)
        board = type(BOARD)("four", parts.names, BOARD.positions[::2], BOARD.rotations[::2])
        run = calibrate_array(log.recording, ArrayRequest(board=board, loop=False), lambda _: None)
        off = (run.total.mean - log.positions)[1:].ravel()
        square.append(off @ np.linalg.solve(run.total.covariance, off) / off.size)
    # Four boards of nine numbers: a standard deviation of 0.24.
    assert 0.4 < np.mean(square) < 1.7
