"""Readings at the end of what a sensor can read are found, whatever the board file states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibrators.array.board import read_board
from imucalib.calibrators.array.log import array_log
from imucalib.recording.recording import Recording
from imucalib.units import DEG
from worlds.boards import BoardPlan, board_log, made_board

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


@pytest.mark.parametrize("hz", [0.5, 2.0, 6.0])
def test_the_turning_points_of_a_steady_swing_are_no_end(quiet: Recording, hz: float) -> None:
    """A sine is at its extreme longer than anywhere else, to within less than its noise."""
    rng, channels = np.random.default_rng(3), dict(quiet.channels)
    for name, c in channels.items():
        if c.quantity == "angular_rate":
            phase = np.array([0.0, 1.0, 2.0])
            swing = 900.0 * DEG * np.sin(2.0 * np.pi * hz * c.t[:, None] + phase)
            channels[name] = replace(c, values=swing + 0.2 * DEG * rng.normal(size=swing.shape))
    log = array_log(replace(quiet, channels=channels), BOARD)
    assert not log.clipped.any()
