"""Several logs of one board become one calibration, and what repeats is told from what does not."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from imucalib import cli
from imucalib.calibration import file
from imucalib.calibrators.array.board import read_board
from imucalib.calibrators.array.calibrate import calibrate_array
from imucalib.calibrators.array.fused.instrument import instrument_of
from imucalib.calibrators.array.logs.board_run import BoardRun, board_run
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.calibrators.array.run import ArrayRun
from imucalib.errors import UsageError
from imucalib.writers import write
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


@pytest.mark.slow
def test_the_command_writes_one_calibration_above_the_logs(tmp_path: Path) -> None:
    paths = []
    for seed in (1, 2):
        paths.append(str(tmp_path / f"log_{seed}.h5"))
        made = board_log(PARTS, replace(PLAN, twist_s=4.0), np.random.default_rng(seed))
        write(made.recording, Path(paths[-1]))
    out = tmp_path / "out"
    arguments = ["array", *paths, "--board", "mimu4444_corners", "--no-loop", "-o", str(out)]
    arguments += ["--distance", "imu0", "imu7", "26.80±0.02mm", "--json", "-q"]
    result = CliRunner().invoke(cli.cli, arguments, standalone_mode=False)
    assert result.return_value == 0, result.output
    content = json.loads(result.stdout)
    together = content["together"]
    assert len(content["logs"]) == 2
    assert together["agreement"]["degrees_of_freedom"] == 21
    assert {"log_1", "log_2", "calibration.yaml", "report.html", "report.json"} == {
        p.name for p in out.iterdir()
    }
    pooled = file.read(out / "calibration.yaml")
    assert [p.sd for p in pooled.parameters] == pytest.approx(np.sqrt(np.diag(pooled.covariance)))
    # The pooled file is an instrument like any log's own.
    assert len(instrument_of(pooled).triads) == 8
    assert np.isfinite(instrument_of(pooled).gyroscope_range)
    far = next(d for d in together["distances_mm"] if d["to"] == "imu7")
    assert far["sd"] <= 0.02
    assert CliRunner().invoke(cli.cli, ["validate", str(out / "calibration.yaml")]).exit_code == 0
