"""The exit code goes by the size of what is left, in the user's terms."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.calibration.findings import Findings
from imucalib.calibration.outcome import Left, Outcome
from imucalib.calibration.provenance import provenance_of
from imucalib.calibrators.array.board import read_board
from imucalib.calibrators.array.estimate.left import Accepted, Residual, what_is_left
from imucalib.loop.found import Unexplained
from imucalib.units import DEG

BOARD = read_board("mimu4444_corners")


def outcome(*left: Left) -> Outcome:
    made = provenance_of(path="log", sha256="", samples=0, mapping={}, settings={})
    structure = Unexplained("a curve", "time", "probe", 0.998, 20.0)
    return Outcome("array", (), made, Findings("unexplained", unexplained=(structure,)), left=left)


def test_size_decides_and_presence_is_cautioned_where_no_size_is_known() -> None:
    small, large = Left("gyros", 1.0, 2.0, "deg/s"), Left("gyros", 3.0, 2.0, "deg/s")
    assert outcome(small).exit_code == 0
    assert outcome(small).status == "ok"
    assert outcome(small, large).exit_code == 5
    assert outcome(small, large).status == "marginal"
    assert outcome().status == "marginal"


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
