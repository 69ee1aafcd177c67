"""A low-pass is no delay: what it weakens was a scale of its IMU, and flexing of all."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.calibrators.array.board import read_board
from imucalib.calibrators.array.loop import worth
from worlds.array_stories import closed
from worlds.boards import made_board
from worlds.odd_boards import PLAN, Plant, odd_log, slow

BOARD = read_board("mimu4444_corners")
ONE = frozenset({2})
OTHERS = {"gyro_misalignment", "gyro_scale"}


@pytest.mark.parametrize(
    ("plant", "name", "rivals"),
    [
        (slow(force=4e-3, imus=ONE), "accelerometer_low_pass@imu2", ()),
        # With few samples the delay's own fit is lost.
        (slow(force=4e-3), "common_accelerometer_low_pass", ("gyro_delay",)),
        (slow(rate=4e-3), "gyro_low_pass", ()),
    ],
    ids=["one accelerometer", "all accelerometers", "all gyros"],
)
def test_it_is_told_as_that_and_by_its_time(
    plant: Plant, name: str, rivals: tuple[str, ...]
) -> None:
    rng = np.random.default_rng(1)
    parts = made_board(BOARD.positions, BOARD.rotations, BOARD.imus, PLAN, rng)
    made = odd_log(parts, plant, PLAN, rng, often=10)
    found = closed(made.recording, 400)
    assert {s.effect for s in found.steps} == OTHERS | {name}
    assert next(s for s in found.steps if s.effect == name).aliases == rivals
    term = next(t for t in found.final.found if t.name == name)
    assert abs(term.theta[0] - 4.0) < 4.0 * found.final.sd_of(term)[0]


DELAY, LOW_PASS, OF_ALL = "gyro_delay", "gyro_low_pass", "common_accelerometer_low_pass"


@pytest.mark.parametrize(
    ("nats", "best", "rivals"),
    [
        ({DELAY: 9.0, LOW_PASS: 5.0}, DELAY, ()),
        ({DELAY: 5.0, LOW_PASS: 9.0}, LOW_PASS, ()),
        ({DELAY: 7.0, LOW_PASS: 9.0}, DELAY, (LOW_PASS,)),  # what stands in the search stays
        ({DELAY: 1.0, LOW_PASS: 9.0, OF_ALL: 8.0}, LOW_PASS, (OF_ALL,)),
    ],
)
def test_twins_that_are_three_nats_apart_are_told_apart(
    nats: dict[str, float], best: str, rivals: tuple[str, ...]
) -> None:
    fits = {name: SimpleNamespace(density=value) for name, value in nats.items()}
    assert worth._nearest(fits, 3.0) == (best, rivals)  # type: ignore[arg-type]


def test_a_twin_whose_fit_is_lost_is_not_ruled_out() -> None:
    fits = {DELAY: SimpleNamespace(converged=True), LOW_PASS: SimpleNamespace(converged=False)}
    assert worth._open({**fits, OF_ALL: None}) == (LOW_PASS, OF_ALL)  # type: ignore[arg-type]
