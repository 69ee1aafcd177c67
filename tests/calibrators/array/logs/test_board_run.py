"""Several logs of one board become one calibration, and what repeats is told from what does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibrators.array.board import read_board
from imucalib.calibrators.array.calibrate import calibrate_array
from imucalib.calibrators.array.logs.board_run import BoardRun, board_run
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.calibrators.array.run import ArrayRun
from imucalib.errors import UsageError
from worlds.boards import BoardPlan, board_log, made_board

BOARD = read_board("mimu4444_corners")
PLAN = BoardPlan(twist_s=8.0, gyro_scale=0.004, gyro_bias=1.0)
PARTS = made_board(BOARD.positions, BOARD.rotations, BOARD.imus, PLAN, np.random.default_rng(7))


def log(seed: int, plan: BoardPlan = PLAN) -> ArrayRun:
    made = board_log(PARTS, plan, np.random.default_rng(seed))
    recording = replace(made.recording, path=f"log_{seed}.h5")
    return calibrate_array(recording, ArrayRequest(BOARD, loop=False), lambda _: None)


@pytest.fixture(scope="module")
def found() -> BoardRun:
    return board_run(tuple(log(seed) for seed in (1, 2, 3)))


@pytest.mark.slow
def test_logs_of_one_board_agree_and_pool(found: BoardRun) -> None:
    assert found.pooled.freedom == 42
    assert found.pooled.p > 1e-3
    one = np.median(np.sqrt(np.diag(found.runs[0].total.motion)))
    assert np.median(np.sqrt(np.diag(found.pooled.covariance))) < 0.75 * one
    off = found.total.distance(0, 7)[0] - np.linalg.norm(PARTS.positions[7])
    assert abs(off) < 4.0 * found.total.distance(0, 7)[1]
    assert found.outcome.exit_code == 0


@pytest.mark.slow
def test_a_log_of_another_board_is_seen() -> None:
    moved = replace(PARTS, positions=PARTS.positions + np.array([0.0, 0.0, 2e-4]) *
                    (np.arange(8) % 2)[:, None])  # fmt: skip
    made = board_log(moved, PLAN, np.random.default_rng(5))
    other = calibrate_array(made.recording, ArrayRequest(BOARD, loop=False), lambda _: None)
    found = board_run((log(1), other))
    assert found.pooled.p < 1e-6
    assert found.pooled.tau > 3e-5
    assert any("differ by more than they state" in text for text in found.outcome.reasons)


def test_one_log_is_no_joint_estimate() -> None:
    with pytest.raises(UsageError, match="two or more logs"):
        board_run(())
