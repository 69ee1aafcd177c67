"""The array's loop: planted errors are named and undone, a clean log is left alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imucalib.calibrators.array_board import read_board
from imucalib.calibrators.array_log import array_log
from imucalib.calibrators.array_loop import ArrayLoop, close_array_loop
from imucalib.calibrators.array_moving import Moving, moving_part
from imucalib.calibrators.array_simulation import LogPlan, simulated_log
from imucalib.calibrators.array_static import fit_static
from imucalib.calibrators.array_timing import rate_slope, with_slope
from imucalib.estimators.array_problem import ArrayPrior
from imucalib.readers import read
from imucalib.recording import Recording
from imucalib.segments import still_segments

BOARD = read_board("mimu4444_corners")
PLAN = LogPlan(poses=14, pose_seconds=3.0, seconds=40.0)
DATA = Path(__file__).parents[1].parent / "shared" / "data" / "mimu4444"


def moving_of(recording: Recording) -> Moving:
    segments = still_segments(recording)
    log, board = array_log(recording, BOARD)
    order = [segments.triads.index(name) for name in board.imus]
    return moving_part(log, fit_static(segments, board, order, 9.80665))


def closed(moving: Moving) -> ArrayLoop:
    prior = ArrayPrior(BOARD.drawn, BOARD.prior_sd, estimate_noise=True)
    found = close_array_loop(moving, prior, np.full(8, 0.2))
    assert found is not None
    return found


@pytest.mark.parametrize("seed", [0, 1])
def test_a_common_delay_is_found_and_undone(seed: int) -> None:
    plan = replace(PLAN, planted={"gyro_delay": 1e-3}, gyro_gain=0.0)
    moving = moving_of(simulated_log(BOARD, plan, np.random.default_rng(seed)).recording)
    found = closed(moving)
    delay = next(step for step in found.steps if step.name == "gyro_delay")
    assert delay.accepted
    assert delay.value.endswith("late")
    assert float(delay.value.split()[0]) == pytest.approx(1.0, abs=0.15)
    again = closed(found.moving)
    assert "gyro_delay" not in {step.name for step in again.accepted}


def test_a_clean_log_is_left_alone() -> None:
    for seed in range(4):
        plan = replace(PLAN, gyro_gain=0.0, gain=0.0)
        found = closed(moving_of(simulated_log(BOARD, plan, np.random.default_rng(seed)).recording))
        assert not found.accepted, found.accepted


def test_chips_on_their_own_clocks_are_found() -> None:
    """Ages planted into gyros of a clean log: the beats come back, and so does the span."""
    plan = replace(PLAN, gyro_gain=0.0, gain=0.0)
    moving = moving_of(simulated_log(BOARD, plan, np.random.default_rng(3)).recording)
    beats = np.array([2.5, -1.1, 0.7, 3.3, -0.4, 1.9, 0.3, -2.2])
    turns = moving.t[:, None] * beats + np.linspace(0.0, 0.9, 8)
    age = 1e-3 * (turns - np.floor(turns) - 0.5)
    slope = np.nan_to_num(rate_slope(moving))
    aged = replace(moving, rate=moving.rate + age[:, :, None] * slope[:, None])
    rows = with_slope(aged, rate_slope(aged))
    assert len(rows) > 1000
    found = closed(aged)
    first = found.steps[0]
    assert first.accepted
    words = first.value.replace(",", " ").split()
    assert float(words[1]) == pytest.approx(1.0, abs=0.1)
    seen = np.array([float(w) for w in words[4:12]])
    assert seen == pytest.approx(beats, abs=0.05)
    assert found.gyro[1] < 0.5 * found.gyro[0]


@pytest.mark.skipif(not DATA.exists(), reason="real data folder absent")
def test_a_measured_boards_clocks_and_delay() -> None:
    found = closed(moving_of(read(DATA / "exp_1.h5")))
    names = {step.name for step in found.accepted}
    assert {"gyro_sample_age", "gyro_delay"} <= names
    assert found.gyro[1] < 0.5 * found.gyro[0]
