"""A board's drawing held against what its sensors felt."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.calibration.apply import apply_to_recording
from imucalib.calibrators.array.board.board import Board, read_board, undrawn_board
from imucalib.calibrators.array.board.drawing import (
    Drawn,
    board_from_log,
    check_board,
)
from imucalib.calibrators.array.board.log import array_log, of_board
from imucalib.calibrators.array.calibrate import calibrate_array
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.calibrators.array.simulation import LogPlan, simulate_log
from imucalib.core.set_up import SIGNED, axes_in_words
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.segments import still_segments
from worlds.boards import BoardPlan, board_log, made_board

PLACES = 0.02 * np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0.2)])


def test_a_board_without_a_drawing_is_sketched_in_the_axes_of_its_first() -> None:
    """Each IMU in any of the 24 proper signed permutations; places to a millimetre."""
    proper, rng = SIGNED[np.linalg.det(SIGNED) > 0.0], np.random.default_rng(5)
    own = np.stack([np.eye(3), *proper[[3, 11, 20]]])
    plan = BoardPlan(rests=10, twist_s=4.0, places=0.0)
    parts = made_board(PLACES, own, ("imu0", "imu1", "imu2", "imu3"), plan, rng)
    recording = board_log(parts, plan, rng).recording
    log = array_log(recording, undrawn_board(4))
    board = board_from_log(log, still_segments(recording), undrawn_board(4))
    np.testing.assert_array_equal(board.rotations, own)
    assert np.abs(board.positions - (PLACES - PLACES.mean(axis=0))).max() < 1e-3
    np.testing.assert_array_equal(board.accelerometer_axes, np.tile(np.eye(3), (4, 1, 1)))


BOARD = read_board("mimu4444_corners")
CHECK_PLAN = LogPlan(poses=12, pose_seconds=3.0, seconds=15.0)
Matrix = NDArray[np.float64]
FLIPPED, SWAPPED = np.diag([1.0, -1.0, 1.0]), np.eye(3)[[1, 0, 2]]
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate_log(BOARD, CHECK_PLAN, np.random.default_rng(1)).recording


def check_seen(recording: Recording, board: Board) -> Drawn:
    wired, board = of_board(recording, board)
    log = array_log(wired, board)
    return check_board(log, still_segments(wired), board)


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
    from imucalib.calibrators.array.board.board import BOARDS

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
    assert f'{sensor}_axes: "{axes_in_words(turn.T)}"' in found.lines[0]
    assert check_seen(broken, with_lines(found.lines, tmp_path / "board.yaml")).faults == ()


@pytest.mark.parametrize("seed", range(6))
def test_a_board_within_its_tolerance_is_let_be(seed: int) -> None:
    plan = replace(CHECK_PLAN, scatter=1e-3, gain=0.02, gyro_gain=0.03, twist=250.0 + 100.0 * seed)
    log = simulate_log(BOARD, plan, np.random.default_rng(seed))
    assert check_seen(log.recording, BOARD).faults == ()


@pytest.mark.slow
def test_a_sensor_wired_otherwise_is_calibrated_and_applied(
    recording: Recording, tmp_path: Path
) -> None:
    broken = wired(wired(recording, "3", "angular", FLIPPED), "5", "accel", SWAPPED)
    board = with_lines(check_seen(broken, BOARD).lines, tmp_path / "board.yaml")
    request = ArrayRequest(board=BOARD, samples=60, loop=False)
    right = calibrate_array(recording, request, lambda _: None)
    mended = calibrate_array(broken, replace(request, board=board), lambda _: None)
    assert mended.total.mean == pytest.approx(right.total.mean, abs=1e-9)
    one = apply_to_recording(right.calibration, recording)
    two = apply_to_recording(mended.calibration, broken)
    for name, channel in one.channels.items():
        assert np.allclose(two.channels[name].values, channel.values, atol=1e-9), name
