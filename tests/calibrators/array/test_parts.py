"""Parts of an array's calibration by hand: gyros, covariances in files, ends of the range."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.triads import effect_covariance, triangle
from imucalib.calibrators.array.board.board import read_board
from imucalib.calibrators.array.board.log import array_log
from imucalib.calibrators.array.fusion.instrument import doubt_of
from imucalib.recording.recording import Recording
from imucalib.units import DEG
from worlds.boards import BoardPlan, board_log, made_board
from worlds.rigid_board import board, calibration


def stated(covariance: np.ndarray | None) -> Calibration:
    truth = calibration(board(np.random.default_rng(1)))
    sd = np.full(24, 0.1)
    block = {
        "effect": "gyro_scale",
        "parameters": [{"value": 0.0, "sd": float(s)} for s in sd],
    }
    if covariance is not None:
        block["covariance"] = triangle(covariance)
    free = 1e-6 * np.eye(21)
    return replace(truth, covariance=free, facts={**truth.facts, "effects": [block]})


def test_a_fused_log_takes_the_covariance_and_else_the_sds() -> None:
    apart = np.eye(24) - np.full((24, 24), 1.0 / 24.0)
    apart *= 0.01 / apart[0, 0]
    for given, expected in ((apart, apart), (None, 0.01 * np.eye(24))):
        file = stated(given)
        doubt = doubt_of(file, np.zeros((8, 3)))
        assert doubt is not None
        root = doubt.effects[0][1]
        assert root @ root.T == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("spoilt", ["short", "other"])
def test_a_covariance_that_does_not_fit_is_refused(spoilt: str) -> None:
    block = dict(stated(0.01 * np.eye(24)).facts["effects"][0])
    rows = block["covariance"]
    block["covariance"] = rows[:-1] if spoilt == "short" else [[4 * x for x in r] for r in rows]
    with pytest.raises(ValueError, match="gyro_scale"):
        effect_covariance(block)


BOARD = read_board("mimu4444_corners")

PLAN = BoardPlan(twist_s=20.0, rests=9, mounting=0.3, gyro_gain=0.01, sigma_gyro=0.0, rate=500.0)


@pytest.fixture(scope="module")
def quiet() -> Recording:
    """A log whose gyros have no noise of their own yet."""
    rng = np.random.default_rng(1)
    parts = made_board(BOARD.positions, BOARD.rotations, BOARD.imus, PLAN, rng)
    return board_log(parts, PLAN, rng).recording


def noisy(quiet: Recording, end: float, sigma: float, imus: tuple[str, ...]) -> Recording:
    """With gyros that saturate in front of the noise, at so many deg/s, each one's end its own."""
    rng, channels = np.random.default_rng(2), dict(quiet.channels)
    for name, c in channels.items():
        if c.quantity == "angular_rate":
            top = end * DEG * (1.0 + 0.01 * rng.normal(size=3))
            held = np.clip(c.values, -top, top) if c.triad in imus else c.values
            values = held + sigma * DEG * rng.normal(size=c.values.shape)
            channels[name] = replace(c, values=values)
    return replace(quiet, channels=channels)


@pytest.mark.parametrize("sigma", [0.05, 0.2, 1.0])
@pytest.mark.parametrize("imus", [BOARD.imus, ("imu2",)], ids=["all", "one"])
def test_a_flat_top_under_noise_is_the_end(
    quiet: Recording, sigma: float, imus: tuple[str, ...]
) -> None:
    rates = [c.values for c in quiet.channels.values() if c.quantity == "angular_rate"]
    names = [c.triad for c in quiet.channels.values() if c.quantity == "angular_rate"]
    log = array_log(noisy(quiet, 1000.0, sigma, imus), BOARD)
    chosen = [r for r, n in zip(rates, names, strict=True) if n in imus]
    over = np.any([np.any(np.abs(r) > 1040.0 * DEG, axis=1) for r in chosen], axis=0)
    under = np.all([np.all(np.abs(r) < 940.0 * DEG, axis=1) for r in chosen], axis=0)
    assert over.sum() > 100
    assert log.clipped[over].all()
    assert not log.clipped[under].any()
    assert len(log.notes) == len(imus)
    assert all("again and again, not at its range of 2000" in note for note in log.notes)
