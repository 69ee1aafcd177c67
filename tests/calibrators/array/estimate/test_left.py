"""The exit code goes by the size of what is left, in the user's terms."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.calibration.findings import Findings
from imucalib.calibration.outcome import Left, Outcome
from imucalib.calibration.provenance import provenance_of
from imucalib.calibrators.array.board import read_board
from imucalib.calibrators.array.calibrate import calibrate_array
from imucalib.calibrators.array.estimate.left import Accepted, Residual, what_is_left
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.calibrators.array.run import ArrayRun
from imucalib.loop.found import Unexplained
from imucalib.report.array import array_card
from imucalib.units import DEG
from worlds.boards import BoardPlan, board_log, made_board

BOARD = read_board("mimu4444_corners")


def outcome(*left: Left) -> Outcome:
    made = provenance_of(path="log", sha256="", samples=0, mapping={}, settings={})
    structure = Unexplained("a curve", "time", "probe", 0.998, 20.0)
    return Outcome("array", (), made, Findings("unexplained", unexplained=(structure,)), left=left)


def run_of(plan: BoardPlan, seed: int, bend: float = 0.0) -> ArrayRun:
    """bend : share of a gyro's reading at 1000 deg/s, growing with it, of either sign by turns."""
    rng = np.random.default_rng(seed)
    parts = made_board(BOARD.positions, BOARD.rotations, BOARD.imus, plan, rng)
    recording = board_log(parts, plan, rng).recording
    gyros = [c for c in recording.channels.values() if c.quantity == "angular_rate"]
    for k, gyro in enumerate(gyros):
        gyro.values[:] *= 1.0 + (-1) ** k * bend * np.abs(gyro.values) / (1000.0 * DEG)
    return calibrate_array(recording, ArrayRequest(BOARD, loop=False), lambda _: None)


def test_size_decides_and_presence_is_cautioned_where_no_size_is_known() -> None:
    small, large = Left("gyros", 1.0, 2.0, "deg/s"), Left("gyros", 3.0, 2.0, "deg/s")
    assert outcome(small).exit_code == 0
    assert outcome(small).status == "ok"
    assert outcome(small, large).exit_code == 5
    assert outcome(small, large).status == "marginal"
    assert outcome().status == "marginal"


@pytest.mark.slow
def test_noise_at_rest_is_not_left() -> None:
    plan = BoardPlan(twist_s=6.0)
    run = run_of(plan, 4)
    assert run.residual.acceleration == pytest.approx(plan.sigma, rel=0.1)
    # Without a search the errors are those of the fit, as median absolute deviations.
    force, rate = run.outcome.errors
    assert force.final == pytest.approx(plan.sigma / 1.4826, rel=0.1)
    assert rate.final == pytest.approx(plan.sigma_gyro / 1.4826, rel=0.2)
    assert np.isnan(force.held_out.final)
    card = array_card(run, ())
    assert not [w for w in card.good_to if "nan" in w.value]
    assert "MAD, fitted; nothing was held out" in card.good_to[2].detail
    assert run.residual.rate == pytest.approx(np.radians(plan.sigma_gyro), rel=0.2)
    quiet = what_is_left(Residual(plan.sigma, 0.0, False), run.rests, None, Accepted())
    assert quiet[0].value < 1.5  # of 4 mg, all noise
    assert quiet[1].value == 0.0


@pytest.mark.parametrize(
    ("noisy", "at_rest", "told"),
    [(1.2, 0.04, ["accelerometer of imu2 in motion"]),
     (1.2, 1.2, ["accelerometer of imu2 in motion"]),
     (0.3, 0.04, [])],
)  # fmt: skip
def test_one_imu_of_eight_that_leaves_more_than_is_accepted_is_told(
    noisy: float, at_rest: float, told: list[str]
) -> None:
    """m/s². No median over all shows it; 0.3 m/s² are within the 50 mg that are accepted."""
    off, still = np.full(8, 0.04), np.full(8, 0.04)
    off[2], still[2] = noisy, at_rest
    gyro = np.full(8, 0.2 * DEG)
    residual = Residual(0.04, 0.2 * DEG, True, (off, gyro), BOARD.imus)
    rests = SimpleNamespace(noise=still, gyro_noise=gyro)
    left = what_is_left(residual, rests, None, Accepted())  # type: ignore[arg-type]
    assert [one.name for one in left if one.beyond] == told
    assert [one.name for one in left[2:]] == told
    if told:
        assert left[2].value == pytest.approx(1e3 * 1.2 / 9.80665, rel=1e-2)
