"""A board's drawing held against what its sensors felt."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.calibration.apply import apply_to_recording
from imucalib.calibrators.array.board import Board, read_board, undrawn_board
from imucalib.calibrators.array.calibrate import calibrate_array
from imucalib.calibrators.array.drawing import (
    SIGNED,
    Drawn,
    compared,
    in_words,
    places,
    relative_axes,
    rough_places,
    sketched,
)
from imucalib.calibrators.array.log import array_log, at_end, at_range, of_board
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.calibrators.array.simulation import LogPlan, simulated_log
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.segments import still_segments
from worlds.boards import DEG, BoardPlan, board_log, made_board, twisted

PLACES = 0.02 * np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0.2)])


def test_a_board_without_a_drawing_is_sketched_in_the_axes_of_its_first() -> None:
    """Each IMU in any of the 24 proper signed permutations; places to a millimetre."""
    proper, rng = SIGNED[np.linalg.det(SIGNED) > 0.0], np.random.default_rng(5)
    own = np.stack([np.eye(3), *proper[[3, 11, 20]]])
    plan = BoardPlan(rests=10, twist_s=4.0, places=0.0)
    parts = made_board(PLACES, own, ("imu0", "imu1", "imu2", "imu3"), plan, rng)
    recording = board_log(parts, plan, rng).recording
    log = array_log(recording, undrawn_board(4))
    board = sketched(log, still_segments(recording), undrawn_board(4))
    np.testing.assert_array_equal(board.rotations, own)
    assert np.abs(board.positions - (PLACES - PLACES.mean(axis=0))).max() < 1e-3
    np.testing.assert_array_equal(board.accelerometer_axes, np.tile(np.eye(3), (4, 1, 1)))


def test_axes_are_told_where_the_others_agree() -> None:
    rng = np.random.default_rng(0)
    truth = rng.normal(size=(30, 3))
    own = SIGNED[[0, 0, 17, 0]]
    read = np.einsum("kji,nj->nki", own, truth)
    same = np.tile(np.eye(3), (4, 1, 1))
    found = relative_axes(read + 0.05 * rng.normal(size=read.shape), same)
    np.testing.assert_array_equal(found, own)
    wild = relative_axes(read + 2.0 * rng.normal(size=read.shape), same)
    np.testing.assert_array_equal(wild[2], np.eye(3))
    assert in_words(SIGNED[0]) == "x,y,z"
    assert in_words(np.array([[0.0, -1, 0], [0, 0, 1], [1, 0, 0]])) == "-y,z,x"


def test_places_are_seen_by_the_forces_differences() -> None:
    plan, rng = BoardPlan(twist_s=4.0), np.random.default_rng(3)
    w, spin, force = twisted(plan, rng)
    t, fast = np.arange(len(w)) / plan.hz, np.linalg.norm(w, axis=1) > 60.0 * DEG
    felt = np.cross(w[:, None], np.cross(w[:, None], PLACES)) + np.cross(spin[:, None], PLACES)
    felt += force[:, None]
    found = rough_places(t, felt + np.array([0.1, 0.0, 0.0]), w, fast)
    assert found is not None
    assert np.abs(found - (PLACES - PLACES.mean(axis=0))).max() < 2e-4
    assert rough_places(t, felt, w, fast & (np.cumsum(fast) < 40)) is None
    assert rough_places(t, felt + 300.0 * rng.normal(size=felt.shape), w, fast) is None
    alike = np.tile(np.eye(3), (4, 1, 1))
    swapped = places(t, felt[:, [0, 2, 1, 3]], w, fast, drawn=PLACES, mounted=alike)
    assert swapped is not None
    assert swapped.place.tolist() == [0, 2, 1, 3]
    assert swapped.exchanged == [1, 2]
    assert not swapped.other_unit


def test_clipping_is_at_the_range_or_where_an_end_repeats() -> None:
    values = np.array([[0.0, 99.9, 0.0], [0.0, 99.7, 0.0], [-99.8, 0.0, 0.0]])
    assert at_range(values, 100.0).tolist() == [True, False, True]
    rng = np.random.default_rng(0)
    noisy = rng.normal(size=(200, 3))
    top = np.sort(np.abs(noisy[:, 0]))[::-1]
    held = noisy.copy()
    held[:, 0] = np.clip(held[:, 0], None, 3.5 * np.median(np.abs(noisy[:, 0])))
    held[:6, 0] = 4.0 * top[0]
    assert np.flatnonzero(at_end(held)).tolist() == list(range(6))
    held[4:6, 0] = 0.0
    assert not at_end(held).any()


BOARD = read_board("mimu4444_corners")


CHECK_PLAN = LogPlan(poses=12, pose_seconds=3.0, seconds=15.0)


Matrix = NDArray[np.float64]


FLIPPED, SWAPPED = np.diag([1.0, -1.0, 1.0]), np.eye(3)[[1, 0, 2]]


QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulated_log(BOARD, CHECK_PLAN, np.random.default_rng(1)).recording


def check_seen(recording: Recording, board: Board) -> Drawn:
    wired, board = of_board(recording, board)
    log = array_log(wired, board)
    return compared(log, still_segments(wired), board)


def wired(recording: Recording, imus: str, quantity: str, turn: Matrix) -> Recording:
    def change(c: Channel) -> Channel:
        hit = c.triad[3:] in imus and quantity in c.quantity
        return replace(c, values=c.values @ turn.T) if hit else c

    return replace(recording, channels={n: change(c) for n, c in recording.channels.items()})


def exchanged(recording: Recording, one: str, two: str) -> Recording:
    other = {one: two, two: one}
    channels = {
        n: replace(recording.channels[f"{other.get(c.triad, c.triad)}/{c.quantity}"], triad=c.triad)
        for n, c in recording.channels.items()
    }
    return replace(recording, channels=channels)


def with_lines(lines: tuple[str, ...], path: Path) -> Board:
    """The board file with these lines for theirs."""
    from imucalib.calibrators.array.board import BOARDS

    text = (BOARDS / "mimu4444_corners.yaml").read_text()
    for line in lines:
        name = line.partition("name: ")[2].partition(",")[0]
        old = next(row for row in text.splitlines() if f"name: {name}," in row)
        text = text.replace(old, line)
    path.write_text(text)
    return read_board(path)


@pytest.mark.parametrize(
    ("change", "fault", "line"),
    [
        (lambda r: wired(r, "3", "angular", FLIPPED), "gyro of imu3", 'gyro_axes: "x,-y,z"'),
        (lambda r: wired(r, "5", "angular", SWAPPED), "gyro of imu5", 'gyro_axes: "y,x,z"'),
        (lambda r: wired(r, "125", "angular", QUARTER), "imu1, imu2, imu5", 'gyro_axes: "y,-x,z"'),
        (lambda r: wired(r, "4", "accel", FLIPPED), "accelerometer of imu4", 'axes: "x,-y,z"'),
        (lambda r: wired(r, "6", "", QUARTER), "imu6 is mounted", 'axes: "y,-x,z"'),
        (lambda r: exchanged(r, "imu0", "imu2"), "imu0 and imu2", "[-9.45, -9.45, 1]"),
        (lambda r: exchanged(r, "imu0", "imu1"), "imu0 and imu1", "[-9.45, 9.45, -1]"),
        (lambda r: exchanged(r, "imu3", "imu5"), "imu3 and imu5", "[9.45, 9.45, -1]"),
        (lambda r: wired(exchanged(r, "imu0", "imu4"), "6", "angular", FLIPPED), "imu0 and imu4",
         'gyro_axes: "x,-y,z"'),
        (lambda r: wired(r, "01234567", "accel", -np.eye(3)), "every accelerometer",
         'accelerometer_axes: "-x,-y,-z"'),
    ],
)  # fmt: skip
def test_its_lines_mend_the_board_file(
    recording: Recording,
    change: Callable[[Recording], Recording],
    fault: str,
    line: str,
    tmp_path: Path,
) -> None:
    broken = change(recording)
    found = check_seen(broken, BOARD)
    assert fault in "; ".join(found.faults)
    assert line in "\n".join(found.lines)
    again = check_seen(broken, with_lines(found.lines, tmp_path / "board.yaml"))
    assert again.faults == ()


@pytest.fixture(scope="module")
def turned() -> Recording:
    """Turned by hand from rest to rest, so that gravity turns as the gyros say."""
    rng, plan = np.random.default_rng(3), BoardPlan(rests=8, twist_s=5.0)
    parts = made_board(BOARD.positions, BOARD.rotations, BOARD.imus, plan, rng)
    return board_log(parts, plan, rng).recording


@pytest.mark.parametrize("turn", [SIGNED[k] for k in (1, 7, 18, 46)])
@pytest.mark.parametrize("sensor", ["accelerometer", "gyro"])
def test_all_sensors_of_a_kind_that_are_wired_alike_are_told(
    turned: Recording, sensor: str, turn: Matrix, tmp_path: Path
) -> None:
    """Alike in the packages, so that top and bottom of the board contradict each other: of all
    accelerometers, every gyro and half of the accelerometers were told."""
    broken = wired(turned, "01234567", "accel" if sensor == "accelerometer" else "angular", turn)
    found = check_seen(broken, BOARD)
    assert found.faults == (f"every {sensor}: other axes or signs than drawn",)
    assert f'{sensor}_axes: "{in_words(turn.T)}"' in found.lines[0]
    assert check_seen(broken, with_lines(found.lines, tmp_path / "board.yaml")).faults == ()


@pytest.mark.parametrize("seed", range(6))
def test_a_board_within_its_tolerance_is_let_be(seed: int) -> None:
    plan = replace(CHECK_PLAN, scatter=1e-3, gain=0.02, gyro_gain=0.03, twist=250.0 + 100.0 * seed)
    log = simulated_log(BOARD, plan, np.random.default_rng(seed))
    assert check_seen(log.recording, BOARD).faults == ()


@pytest.mark.slow
def test_a_sensor_wired_otherwise_is_calibrated_and_applied(
    recording: Recording, tmp_path: Path
) -> None:
    broken = wired(wired(recording, "3", "angular", FLIPPED), "5", "accel", SWAPPED)
    board = with_lines(check_seen(broken, BOARD).lines, tmp_path / "board.yaml")
    request = ArrayRequest(BOARD, samples=60, loop=False)
    right = calibrate_array(recording, request, lambda _: None)
    mended = calibrate_array(broken, replace(request, board=board), lambda _: None)
    assert mended.final.mean == pytest.approx(right.final.mean, abs=1e-9)
    one = apply_to_recording(right.calibration, recording)
    two = apply_to_recording(mended.calibration, broken)
    for name, channel in one.channels.items():
        assert np.allclose(two.channels[name].values, channel.values, atol=1e-9), name
