"""Rigs of any kind: pairs, lines, and boards without a drawing."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.calibrators.array.board import Board, read_board, undrawn_board
from imucalib.calibrators.array.calibrate import calibrate_array
from imucalib.calibrators.array.loop.search import start_state
from imucalib.calibrators.array.loop.setup import array_setup
from imucalib.calibrators.array.loop.terms import rest_terms
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.calibrators.array.run import ArrayRun
from imucalib.recording.recording import Recording
from worlds.boards import BoardPlan, board_log, made_board

PLAN = BoardPlan(twist_s=8.0)
CORNERS = read_board("mimu4444_corners")


def rig(*places: tuple[float, float, float]) -> Board:
    at = 1e-3 * np.array(places)
    k = len(at)
    return Board("rig", tuple(f"imu{i}" for i in range(k)), at, np.tile(np.eye(3), (k, 1, 1)))


def logged(board: Board, seed: int = 1, plan: BoardPlan = PLAN) -> tuple[Recording, np.ndarray]:
    rng = np.random.default_rng(seed)
    parts = made_board(board.positions, board.rotations, board.imus, plan, rng)
    return board_log(parts, plan, rng).recording, parts.positions


def calibrated(recording: Recording, board: Board) -> ArrayRun:
    return calibrate_array(recording, ArrayRequest(board, loop=False), lambda _: None)


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 3])
def test_a_pair_and_a_line_are_calibrated(count: int) -> None:
    board = rig(*[(20.0 * i / (count - 1), 0.0, 0.0) for i in range(count)])
    recording, true = logged(board)
    run = calibrated(recording, board)
    assert run.outcome.exit_code == 0
    value, sd = run.total.distance(0, count - 1)
    assert sd < 1e-4
    assert abs(value - np.linalg.norm(true[-1])) < 4.0 * sd
    assert any("spin about it stays open" in note for note in run.outcome.notes)


@pytest.mark.slow
def test_a_board_is_found_without_a_drawing() -> None:
    recording, true = logged(CORNERS)
    drawn, bare = calibrated(recording, CORNERS), calibrated(recording, undrawn_board(8))
    # In the axes of the first IMU, which are the board's here.
    one, two = drawn.total.by_motion, bare.total.by_motion
    left, _, right = np.linalg.svd(two.T @ one)
    assert two @ left @ right == pytest.approx(one, abs=1e-5)
    for k in range(1, 8):
        value, sd = bare.total.distance(0, k)
        assert abs(value - np.linalg.norm(true[k])) < 4.5 * sd
    assert bare.board.prior_sd > 0.01


@pytest.mark.parametrize("count", [2, 3])
def test_the_noise_of_few_imus_keeps_its_shape_and_its_size(count: int) -> None:
    """The motion takes whole directions of their errors: what it leaves of a pair's forces lies
    along one line, so that squares of Gaussian errors scatter as those of tails would."""
    board = rig(*[(20.0 * i, 0.0, 0.0) for i in range(count)])
    run = calibrated(logged(board)[0], board)
    moving, rests = run.moving, run.rests
    setup = array_setup(moving, board, 600, robust=True)
    assert setup is not None
    state = start_state(setup, rest_terms(rests))
    for noise, sigma in zip(state.noise, (PLAN.sigma, np.deg2rad(PLAN.sigma_gyro)), strict=True):
        assert noise.plain
        assert noise.sigma == pytest.approx(sigma, rel=0.06)
