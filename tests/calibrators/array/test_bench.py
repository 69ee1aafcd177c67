"""Boards from log to positions, and logs that cannot give them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imucalib.calibrators.array.board.board import Board, read_board, undrawn_board
from imucalib.calibrators.array.calibrate import calibrate_array
from imucalib.calibrators.array.motion.setup import array_setup
from imucalib.calibrators.array.motion.state import start_state
from imucalib.calibrators.array.motion.terms import rest_terms
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.calibrators.array.run import ArrayRun
from imucalib.calibrators.array.simulation import LogPlan, SimulatedLog, simulate_log
from imucalib.errors import ImucalError, Undetermined, UnreadableInput, UsageError
from imucalib.readers import read
from imucalib.recording.recording import Channel, Recording
from imucalib.units import DEG
from worlds.boards import BoardPlan, board_log, made_board
from worlds.places import SAMPLES

BOARD = read_board("mimu4444_corners")
PLAN = LogPlan(poses=14, pose_seconds=3.0, seconds=25.0, gyro_gain=0.0)


def calibrate(recording: Recording, **options: object) -> ArrayRun:
    request = replace(ArrayRequest(board=BOARD, samples=150), **options)  # type: ignore[arg-type]
    return calibrate_array(recording, request, lambda _: None)


@pytest.fixture(scope="module")
def log() -> SimulatedLog:
    return simulate_log(BOARD, PLAN, np.random.default_rng(0))


@pytest.fixture(scope="module")
def run(log: SimulatedLog) -> ArrayRun:
    return calibrate(log.recording)


def _drawn(path: Path, places: list[str]) -> Path:
    lines = [f"  - {{name: m{k}, position: [{p}], axes: 'x,y,z'}}" for k, p in enumerate(places)]
    path.write_text("\n".join(["imus:", *lines]), encoding="utf-8")
    return path


def test_a_flat_drawing_and_a_line_are_read(tmp_path: Path) -> None:
    corners = ["0, 0, 1", "20, 0, 1", "0, 20, 1", "20, 20, 1"]
    line, two = ["0, 0, 0", "5, 5, 5", "7, 7, 7", "9, 9, 9"], ["0, 0, 0", "0, 2, 0"]
    for places in (corners, line, two):
        assert read_board(_drawn(tmp_path / "drawn.yaml", places)).count == len(places)
    assert read_board("5").undrawn
    with pytest.raises(UsageError, match="two or more"):
        read_board("1")


IMU = "{name: %s, position: [%s], axes: 'x,y,z'}"


@pytest.mark.parametrize(
    ("text", "message", "remedy"),
    [
        ("imus: 3", "incomplete", "position"),
        (f"imus: [{IMU % ('a', '0, 0, 0')}]", "two or more", ""),
        ("[", "not a YAML", ""),
        (f"imus: [{IMU % ('a', '1, 2, 3')}, {IMU % ('b', '1, 2, 3')}]", "extends 0", "--board 2"),
        (f"imus: [{IMU % ('a */ int x;', '0, 0, 0')}, {IMU % ('b', '9, 0, 0')}]", "';'", ""),
        ("gyro_scope_range: 2000\nimus: []", "unknown key", "gyroscope_range"),
        ("imus: [{name: a, posit: [0, 0, 0]}]", "unknown key", "position"),
        ("colour: red\nimus: []", "unknown key", "known are"),
    ],
)
def test_bad_boards(tmp_path: Path, text: str, message: str, remedy: str) -> None:
    path = tmp_path / "board.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UnreadableInput, match=message) as caught:
        read_board(path)
    assert remedy in (caught.value.remedy or "")


@pytest.mark.slow
def test_positions_are_recovered_within_what_is_stated(log: SimulatedLog, run: ArrayRun) -> None:
    assert run.segments.n >= 9
    assert run.rests.residual < 0.02
    # The frame is the triads' mean one, turned a little against the true board.
    truth, found = log.positions[1:], run.total.mean[1:]
    left, _, right = np.linalg.svd(truth.T @ found)
    z = (found - truth @ left @ right) / run.total.sd[1:]
    assert np.sqrt(np.mean(z * z)) < 2.0
    assert run.drawn.convergence.bulk.min() >= 400.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plan", "message"),
    [
        (replace(PLAN, poses=5), "at least 9 are needed"),
        (replace(PLAN, seconds=0.0), "too little rotation"),
        (replace(PLAN, twist=10.0), "too little rotation"),
    ],
)
def test_logs_that_cannot_answer(plan: LogPlan, message: str) -> None:
    log = simulate_log(BOARD, plan, np.random.default_rng(1))
    with pytest.raises(Undetermined, match=message):
        calibrate(log.recording)


@pytest.mark.slow
def test_a_measured_board() -> None:
    """Underside accelerometers lie half a millimetre off the packages' middle, as published."""
    run = calibrate(read(SAMPLES / "board.h5"), gravity=9.8189, samples=400)
    off = 1e3 * (run.total.mean - BOARD.drawn)
    under = off[1::2].mean(axis=0)
    assert under == pytest.approx([-0.55, -0.45, -0.18], abs=0.15)
    assert np.abs(off[2::2].mean(axis=0)).max() < 0.2
    # What is left is small in the terms of who uses it: 0.22 m/s², 1.2 deg/s.
    assert run.outcome.exit_code == 0
    assert run.outcome.findings is not None
    assert run.outcome.findings.open


Change = Callable[[str, Channel], Channel]


def scaled(part: str, factor: float) -> Change:
    """Channels whose name ends with `part` in a unit that nobody said."""
    return lambda name, c: replace(c, values=c.values * factor) if name.endswith(part) else c


def slower(part: str) -> Change:
    def change(name: str, c: Channel) -> Channel:
        if not name.endswith(part):
            return c
        return Channel(c.t[::2], c.values[::2], c.unit, c.quantity, c.triad, 50.0)

    return change


def later(part: str, seconds: float) -> Change:
    return lambda name, c: replace(c, t=c.t + seconds) if name.endswith(part) else c


def held(part: str, axis: int, value: float) -> Change:
    def change(name: str, c: Channel) -> Channel:
        values = np.where(np.arange(3) == axis, value, c.values)
        return replace(c, values=values) if name.endswith(part) else c

    return change


@pytest.mark.parametrize(
    ("change", "kind", "message", "remedy"),
    [
        (scaled("/acceleration", 1 / 9.80665), Undetermined, "0.1 times gravity", "unit"),
        (scaled("imu3/acceleration", 0.1), Undetermined, "imu3 reads 0.1 times", "unit"),
        (scaled("/acceleration", 1e3), Undetermined, r"1e\+03 times gravity", "unit"),
        (scaled("/angular_rate", 1 / DEG), Undetermined, "too little rotation", "gyros' unit"),
        (scaled("/angular_rate", DEG), Undetermined, "too little rotation", "gyros' unit"),
        (scaled("imu3/angular_rate", 1 / DEG), Undetermined, "gyro of imu3 reads 57 times", "unit"),
        (scaled("imu3/angular_rate", DEG), Undetermined, "gyro of imu3 reads 0.017", "57.3"),
        (slower("imu2/acceleration"), UnreadableInput, "different rates, 50 to 100 Hz", "one rate"),
        (slower("imu0/angular_rate"), UnreadableInput, "different rates, 50 to 100 Hz", "one rate"),
        (later("imu2/acceleration", 0.005), UnreadableInput, "within 3 ms", "common clock"),
        (later("imu2/angular_rate", 1e3), UnreadableInput, "only 0 % of the samples", "clock"),
        (held("imu5/acceleration", 2, 0.0), UnreadableInput, "axis z never changes", "dead"),
        (held("imu5/angular_rate", 0, 0.3), UnreadableInput, "axis x never changes", "dead"),
    ],
)
def test_a_fault_is_named(
    log: SimulatedLog, change: Change, kind: type[ImucalError], message: str, remedy: str
) -> None:
    channels = {name: change(name, c) for name, c in log.recording.channels.items()}
    with pytest.raises(kind, match=message) as caught:
        calibrate(replace(log.recording, channels=channels), loop=False)
    assert remedy in (caught.value.remedy or "")


@pytest.mark.parametrize("gone", ["imu4/acceleration", "imu4/angular_rate"])
def test_a_missing_sensor_is_named(log: SimulatedLog, gone: str) -> None:
    channels = {name: c for name, c in log.recording.channels.items() if name != gone}
    with pytest.raises(UnreadableInput, match="imu4") as caught:
        calibrate(replace(log.recording, channels=channels), loop=False)
    assert "--gyro" in (caught.value.remedy or "")


RIGS_PLAN = BoardPlan(twist_s=8.0)


def rig(*places: tuple[float, float, float]) -> Board:
    at = 1e-3 * np.array(places)
    k = len(at)
    return Board("rig", tuple(f"imu{i}" for i in range(k)), at, np.tile(np.eye(3), (k, 1, 1)))


def logged(board: Board) -> tuple[Recording, np.ndarray]:
    rng = np.random.default_rng(1)
    parts = made_board(board.positions, board.rotations, board.imus, RIGS_PLAN, rng)
    return board_log(parts, RIGS_PLAN, rng).recording, parts.positions


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 3])
def test_a_pair_and_a_line_are_calibrated(count: int) -> None:
    board = rig(*[(20.0 * i / (count - 1), 0.0, 0.0) for i in range(count)])
    recording, true = logged(board)
    run = calibrate(recording, board=board, samples=None, loop=False)
    assert run.outcome.exit_code == 0
    value, sd = run.total.distance(0, count - 1)
    assert sd < 1e-4
    assert abs(value - np.linalg.norm(true[-1])) < 4.0 * sd


@pytest.mark.slow
def test_a_board_is_found_without_a_drawing() -> None:
    recording, true = logged(BOARD)
    drawn, bare = (
        calibrate(recording, board=b, samples=None, loop=False) for b in (BOARD, undrawn_board(8))
    )
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
    run = calibrate(logged(board)[0], board=board, samples=None, loop=False)
    moving, rests = run.moving, run.rests
    setup = array_setup(moving, board, 600)
    assert setup is not None
    state = start_state(setup, rest_terms(rests))
    for noise, sigma in zip(
        state.noise, (RIGS_PLAN.sigma, np.deg2rad(RIGS_PLAN.sigma_gyro)), strict=True
    ):
        assert noise.gained == 0.0
        assert noise.sigma == pytest.approx(sigma, rel=0.06)
