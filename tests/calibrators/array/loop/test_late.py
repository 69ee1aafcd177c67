"""Late sensors: what they sense was so a moment before, whatever else acts on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.calibrators.array.board import read_board
from imucalib.calibrators.array.loop.catalogue import array_catalogue
from imucalib.calibrators.array.loop.motion import BoardMotion, board_motion
from imucalib.calibrators.array.loop.terms import Term, columns_of, determined, lateness
from worlds.array_stories import closed, named
from worlds.boards import made_board
from worlds.odd_boards import PLAN, PLANTS, odd_log, shifted

BOARD = read_board("mimu4444_corners")
LATE = np.array([2.0, 2.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def test_late_imus_are_late_and_nothing_else() -> None:
    """Gains of half a percent act on what was 2 ms before, and the delay is no straight line."""
    rng = np.random.default_rng(1)
    parts = made_board(BOARD.positions, BOARD.rotations, BOARD.imus, PLAN, rng)
    found = closed(odd_log(parts, PLANTS["late few"], PLAN, rng).recording, 400)
    told = {"accelerometer_delay", "gyro_delay_each", "gyro_misalignment", "gyro_scale"}
    assert named(found) == told
    assert not found.unexplained
    for name in ("accelerometer_delay", "gyro_delay_each"):
        delay = next(t for t in found.final.found if t.name == name).theta
        # Of both kinds together the time itself is free.
        np.testing.assert_allclose(delay - delay.mean(), LATE - LATE.mean(), atol=0.05)


def swung(t: Array) -> BoardMotion:
    """All packages alike: ω and the force swing at 4 and 3 Hz."""
    w, f = 8.0 * np.pi, 6.0 * np.pi
    rate, force = (np.sin(x * t)[:, None] * [1.0, -2.0, 0.5] for x in (w, f))
    spin, jerk = (x * np.cos(x * t)[:, None] * [1.0, -2.0, 0.5] for x in (w, f))
    every = (len(t), 2, 3)
    return board_motion(
        imus=("imu0", "imu1"), rotations=np.tile(np.eye(3), (2, 1, 1)), t=t, order=t, rate=rate,
        spin=spin, force=np.broadcast_to(force[:, None], every),
        jerk=np.broadcast_to(jerk[:, None], every),
    )  # fmt: skip


def term(name: str, delay: list[float]) -> Term:
    return Term(name, array_catalogue()[name], None, np.eye(len(delay)), np.array(delay),
                np.ones(len(delay)))  # fmt: skip


def test_what_acts_on_a_late_reading_acts_on_what_was_then() -> None:
    t = np.linspace(0.0, 1.0, 50)
    here, late = swung(t), [0.0, 1.5]
    own = term("gyro_delay_each", late)
    both = lateness([own, term("accelerometer_delay", [0.5, 0.0])], here)
    assert both is not None
    np.testing.assert_allclose(both[0][0], [0.0, 1.5e-3], atol=1e-15)
    np.testing.assert_allclose(both[1][0], [0.5e-3, 0.0], atol=1e-15)
    bend = -((8.0 * np.pi) ** 2) * here.truth.turning.rate[:, 0]
    sway = -((6.0 * np.pi) ** 2) * here.truth.force
    then = here.late(both, bend, sway)
    earlier = swung(t - 1.5e-3).truth.turning.rate[:, 1]
    # The third order is left: (8 π 1.5e-3)³ / 6 of the swing.
    sensed = then.truth_of("angular_rate").turning.rate
    np.testing.assert_allclose(sensed[:, 1], earlier, atol=2e-5)
    np.testing.assert_allclose(sensed[:, 0], here.truth.turning.rate[:, 0], atol=1e-15)
    felt = then.truth_of("acceleration").force
    np.testing.assert_allclose(felt[:, 0], swung(t - 0.5e-3).truth.force[:, 0], atol=1e-6)
    assert then.midway is not None
    lost = own.reading(own.columns(then.midway))[:, 1]
    np.testing.assert_allclose(here.truth.turning.rate[:, 1] + lost, earlier, atol=2e-5)
    scale = columns_of(array_catalogue()["gyro_scale"], then).basis[1]
    np.testing.assert_allclose(np.einsum("tii->ti", scale), 0.01 * earlier, atol=2e-7)


def test_no_delay_is_told_of_what_is_none() -> None:
    here = swung(np.linspace(0.0, 1.0, 5))
    assert lateness([term("gyro_scale", [1.0] * 6)], here) is None
    one = replace(term("gyro_delay_each", [2.0]), only=1)
    np.testing.assert_allclose(one.late(here), [[0.0, 2e-3]] * 5, atol=1e-15)


@pytest.mark.parametrize(("beside", "rank"), [("accelerometer_delay", 1), ("gyro_scale", 2)])
def test_the_time_itself_is_nobodys(beside: str, rank: int) -> None:
    """What all delays of both kinds of sensor share is no delay at all."""
    other = term(beside, [0.0, 0.0])
    effect = array_catalogue()["gyro_delay_each"]
    found = determined("gyro_delay_each", effect, None, 1e4 * np.eye(2), [other])
    assert found.live.shape[1] == rank
    if rank == 1:
        assert abs(found.live.sum()) < 1e-12


def test_a_shifted_swing_is_as_it_was() -> None:
    t = np.arange(400) / 100.0
    swing = np.sin(8.0 * np.pi * t)[:, None] * np.ones(3)
    due = np.sin(8.0 * np.pi * (t - 2e-3))[:, None] * np.ones(3)
    np.testing.assert_allclose(shifted(t, swing, 2e-3), due, atol=1e-4)
