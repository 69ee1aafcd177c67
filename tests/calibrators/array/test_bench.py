"""`imucal array` from a bench log to its files, and what it says of logs that cannot work."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imucalib.calibrators.array.board import board_names, read_board
from imucalib.calibrators.array.calibrate import calibrate_array
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.calibrators.array.run import ArrayRun
from imucalib.calibrators.array.simulation import LogPlan, SimulatedLog, simulated_log
from imucalib.errors import Undetermined, UnreadableInput, UsageError
from imucalib.readers import read
from imucalib.recording.recording import Recording
from worlds.places import SAMPLES

BOARD = read_board("mimu4444_corners")
PLAN = LogPlan(poses=14, pose_seconds=3.0, seconds=25.0, gyro_gain=0.0)


def calibrate(recording: Recording, **options: object) -> ArrayRun:
    request = replace(ArrayRequest(BOARD, samples=150), **options)  # type: ignore[arg-type]
    return calibrate_array(recording, request, lambda _: None)


@pytest.fixture(scope="module")
def log() -> SimulatedLog:
    return simulated_log(BOARD, PLAN, np.random.default_rng(0))


@pytest.fixture(scope="module")
def run(log: SimulatedLog) -> ArrayRun:
    return calibrate(log.recording)


def _drawn(path: Path, places: list[str]) -> Path:
    lines = [f"  - {{name: m{k}, position: [{p}], axes: 'x,y,z'}}" for k, p in enumerate(places)]
    path.write_text("\n".join(["imus:", *lines]), encoding="utf-8")
    return path


def test_a_flat_drawing_and_a_line_are_read_and_a_point_is_not(tmp_path: Path) -> None:
    corners = ["0, 0, 1", "20, 0, 1", "0, 20, 1", "20, 20, 1"]
    assert not read_board(_drawn(tmp_path / "flat.yaml", corners)).on_a_line
    for line in (["0, 0, 0", "5, 5, 5", "7, 7, 7", "9, 9, 9"], ["0, 0, 0", "0, 2, 0"]):
        assert read_board(_drawn(tmp_path / "line.yaml", line)).on_a_line
    with pytest.raises(UnreadableInput, match="extends 0 µm") as caught:
        read_board(_drawn(tmp_path / "point.yaml", ["1, 2, 3"] * 4))
    assert "--board 4" in str(caught.value.remedy)
    assert read_board("5").undrawn
    with pytest.raises(UsageError, match="two or more"):
        read_board("1")


@pytest.mark.slow
def test_positions_are_recovered_within_what_is_stated(log: SimulatedLog, run: ArrayRun) -> None:
    assert run.segments.n >= 9
    assert run.rests.residual < 0.02
    # The frame is the triads' mean one, turned a little against the true board.
    truth, found = log.positions[1:], run.final.mean[1:]
    left, _, right = np.linalg.svd(truth.T @ found)
    z = (found - truth @ left @ right) / run.final.sd[1:]
    assert np.sqrt(np.mean(z * z)) < 2.0
    assert run.final.convergence.reached()


def test_a_wrong_mounting_is_refused(log: SimulatedLog) -> None:
    rotations = BOARD.rotations.copy()
    rotations[5] = np.eye(3)
    with pytest.raises(Undetermined, match="imu5 is mounted otherwise"):
        calibrate(log.recording, board=replace(BOARD, rotations=rotations))


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
    log = simulated_log(BOARD, plan, np.random.default_rng(1))
    with pytest.raises(Undetermined, match=message):
        calibrate(log.recording)


def test_boards_that_come_along() -> None:
    assert board_names() == ("mimu4444", "mimu4444_corners")
    whole = read_board("mimu4444")
    assert whole.count == 32
    assert whole.drawn[1] == pytest.approx([0.0, 0.0, -2e-3])
    distances = np.linalg.norm(whole.positions[:, None] - whole.positions, axis=2)
    assert np.sort(distances + 9.0 * np.eye(32), axis=1)[:, 1] == pytest.approx(np.full(32, 6.3e-3))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("imus: 3", "incomplete"),
        ("imus: [{name: a, position: [0, 0, 0]}]", "two or more"),
        ("[", "not a YAML"),
    ],
)
def test_bad_boards(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "board.yaml"
    path.write_text(text)
    with pytest.raises(UnreadableInput, match=message):
        read_board(path)


@pytest.mark.slow
def test_a_measured_board() -> None:
    """Underside accelerometers lie half a millimetre off the packages' middle, as published."""
    run = calibrate(read(SAMPLES / "board.h5"), gravity=9.8189, samples=400)
    off = 1e3 * (run.final.mean - BOARD.drawn)
    under = off[1::2].mean(axis=0)
    assert under == pytest.approx([-0.55, -0.45, -0.18], abs=0.15)
    assert np.abs(off[2::2].mean(axis=0)).max() < 0.2
    # What is left is small in the terms of who uses it: 0.22 m/s², 1.2 deg/s.
    assert run.outcome.exit_code == 0
    assert run.outcome.findings is not None
    assert run.outcome.findings.open
