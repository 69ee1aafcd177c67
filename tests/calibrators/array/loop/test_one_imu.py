"""What one IMU alone does is told as that IMU's: boards with something that nobody declared."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibrators.array.board import read_board
from imucalib.calibrators.array.findings import advice
from imucalib.calibrators.array.loop.catalogue import array_catalogue
from worlds.array_stories import closed, moving_of, named, positions_z
from worlds.boards import made_board
from worlds.odd_boards import PLAN, PLANTS, odd_log

BOARD = read_board("mimu4444_corners")


@pytest.mark.parametrize(
    ("plant", "name", "true"),
    [
        ("flexing", "flexing@imu3", (0.03, 0.03, 0.1, 0.0, 0.0, 0.0)),
        ("by rate", "moved_by_rate@imu3", (0.12, -0.1, 0.12)),
        ("gyro drifting", "gyro_scale_drift@imu2", (2.0, 2.0, 2.0)),
    ],
)
def test_it_is_told_as_that_imus(plant: str, name: str, true: tuple[float, ...]) -> None:
    rng = np.random.default_rng(1)
    parts = made_board(BOARD.positions, BOARD.rotations, BOARD.imus, PLAN, rng)
    made = odd_log(parts, PLANTS[plant], PLAN, rng)
    found = closed(made.recording, 400)
    assert name in {s.effect for s in found.steps if s.certain}
    assert named(found) <= {"gyro_misalignment", "gyro_scale", name}
    rests = moving_of(made.recording)[1]
    told = advice(found, rests)
    assert sum(name[-4:] in line and name[:-5] in line for line in told) == 1
    term = next(t for t in found.final.found if t.name == name)
    slight = tuple(replace(t, value=0.02 * t.value) for t in found.final.terms)
    few = replace(found, final=replace(found.final, terms=slight))
    assert not any(name[-4:] in line and "alone" in line for line in advice(few, rests))
    sd = found.final.sd_of(term)
    # In the package's own axes; the drawing's is board to package.
    turn = BOARD.rotations[int(name[-1])]
    if plant == "flexing":
        xx, yy, zz, xy, xz, yz = term.theta
        own = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
        got = np.array([*np.diag(own), own[0, 1], own[0, 2], own[1, 2]])
    else:
        got = np.abs(turn) @ term.theta if plant == "gyro drifting" else turn @ term.theta
    # The order of the motion runs from the first turn to the end, 97 % of the log.
    assert np.abs(got - true).max() < 5.0 * sd.max() + 0.03 * np.abs(true).max()


@pytest.mark.parametrize(
    ("plant", "name"),
    [("gyro saturating", "gyro_saturation@imu0"), ("gyros saturating", "gyro_saturation")],
)
def test_gyros_that_saturate_softly_are_told_and_move_no_position(plant: str, name: str) -> None:
    rng = np.random.default_rng(1)
    parts = made_board(BOARD.positions, BOARD.rotations, BOARD.imus, PLAN, rng)
    made = odd_log(parts, PLANTS[plant], PLAN, rng)
    found = closed(made.recording, 400)
    assert name in named(found) <= {"gyro_misalignment", "gyro_scale", name}
    assert np.sqrt(np.mean(positions_z(found, made.positions) ** 2)) < 2.0
    # Of a tanh's series two powers hold the most.
    third, fifth = next(t for t in found.final.found if t.name == name).theta[[0, 3]]
    limit = 1500.0 if plant == "gyro saturating" else 2500.0
    assert 0.7 < third / (-(2000.0**3) / (3.0 * limit**2)) < 1.1
    assert 0.3 < fifth / (2.0 * 2000.0**5 / (15.0 * limit**4)) < 1.1


@pytest.mark.parametrize("seed", [1, 2])
def test_a_gyro_that_reads_more_of_one_direction_is_told_as_that(seed: int) -> None:
    """A square, a cube, a bias and a drift of that IMU were four wrong names, three as certain."""
    rng = np.random.default_rng(seed)
    parts = made_board(BOARD.positions, BOARD.rotations, BOARD.imus, PLAN, rng)
    made = odd_log(parts, PLANTS["one-sided"], PLAN, rng)
    found = closed(made.recording, 600)
    families = {name.partition("@")[0] for name in named(found)}
    assert families == {"gyro_misalignment", "gyro_scale", "gyro_asymmetry"}
    assert "gyro_asymmetry@imu3" in named(found)
    term = next(t for t in found.final.found if t.name.startswith("gyro_asymmetry"))
    # Half of it in either direction, the mean is a scale; in the package's own axes.
    each = np.zeros((8, 3))
    each[slice(None) if term.only is None else [term.only]] = term.theta.reshape(-1, 3)
    own = np.zeros((8, 3))
    own[3] = 0.5 * np.abs(BOARD.rotations[3].T @ [1.0, 0.0, 0.0])
    assert np.abs(each) == pytest.approx(own, abs=0.04)
    # The mean scale of all gyros, a sixteenth of it, is the size's; beside it nothing moves.
    truth, r = made.positions[1:], found.final.r[1:]
    left, _, right = np.linalg.svd(truth.T @ r)
    turned = truth @ left @ right
    size = np.sum(turned * r) / np.sum(turned**2)
    assert size == pytest.approx(1.0, abs=2e-3)
    assert np.abs(r - size * turned).max() < 5e-5


def test_every_effect_of_its_own_is_tried_on_each_imu() -> None:
    for effect in array_catalogue().values():
        assert effect.scan is not effect.shared
