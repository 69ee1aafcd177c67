"""A low-pass is no delay: what it weakens was a scale of its IMU, and flexing of all."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.calibrators.array.board import read_board
from imucalib.calibrators.array.loop.closed_loop import MotionLoop
from worlds.array_stories import closed
from worlds.boards import Array, made_board
from worlds.odd_boards import PLAN, Moved, Plant, Planted, odd_log, plain, shifted, slow

BOARD = read_board("mimu4444_corners")
ONE = frozenset({2})
OTHERS = {"gyro_misalignment", "gyro_scale"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plant", "name", "ms", "rivals"),
    [
        (slow(force=4e-3, imus=ONE), "accelerometer_low_pass@imu2", 4.0, ()),
        (slow(force=4e-3), "common_accelerometer_low_pass", 4.0, ()),
        # Its fit ran away: flexing and a place that moves were certain, positions 5 sds off.
        (slow(force=8e-3), "common_accelerometer_low_pass", 8.0, ()),
        (slow(rate=4e-3), "gyro_low_pass", 4.0, ()),
    ],
    ids=["one accelerometer", "all accelerometers", "all of them, slower", "all gyros"],
)
def test_it_is_told_as_that_and_by_its_time(
    plant: Plant, name: str, ms: float, rivals: tuple[str, ...]
) -> None:
    rng = np.random.default_rng(1)
    parts = made_board(BOARD.positions, BOARD.rotations, BOARD.imus, PLAN, rng)
    made = odd_log(parts, plant, PLAN, rng, often=10)
    found = closed(made.recording, 400 if ms < 8.0 else 600)
    assert {s.effect for s in found.steps} == OTHERS | {name}
    assert next(s for s in found.steps if s.effect == name).aliases == rivals
    term = next(t for t in found.final.found if t.name == name)
    assert abs(term.theta[0] - ms) < 4.0 * found.final.sd_of(term)[0]


def _made(plant: Plant) -> MotionLoop:
    rng = np.random.default_rng(1)
    parts = made_board(BOARD.positions, BOARD.rotations, BOARD.imus, PLAN, rng)
    return closed(odd_log(parts, plant, PLAN, rng, often=10).recording, 400)


@pytest.mark.slow
def test_small_lags_are_doubtful_between_a_delay_and_a_low_pass() -> None:
    """0.02 ms about the mean of all: a low-pass and a delay differ by 1e-4 deg/s."""
    late = 2e-5 * np.array([1.0, -1.0, 0.5, -0.5, 1.0, -1.0, 0.7, -0.7])

    def plant(m: Moved, r: Array, k: int) -> Planted:
        one = plain(m, r, k)
        return Planted(one.felt, shifted(m.t, one.rate, late[k]))

    step = next(s for s in _made(plant).steps if "each" in s.effect)
    assert {step.effect, *step.aliases} >= {"gyro_delay_each", "gyro_low_pass_each"}
    assert not step.certain
