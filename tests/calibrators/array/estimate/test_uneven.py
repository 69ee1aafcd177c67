"""Positions that differ from part to part of the motion are told, and known no better than that."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.calibrators.array.board import read_board
from imucalib.calibrators.array.calibrate import calibrate_array
from imucalib.calibrators.array.estimate.covariance import Uneven, uneven
from imucalib.calibrators.array.request import ArrayRequest
from worlds.boards import Array, made_board
from worlds.odd_boards import PLAN, bowing_and_tilting, odd_log

N, BLOCKS, D = 2400, 12, 6


def asked(
    pulls: Array, rate: Array | None = None, force: Array | None = None, factor: float = 1.0
) -> Uneven | None:
    """Of N samples in BLOCKS parts of time."""
    rng = np.random.default_rng(9)
    one = rng.normal(size=(N, 3)) if rate is None else rate
    two = rng.normal(size=(N, 3)) if force is None else force
    state = SimpleNamespace(
        setup=SimpleNamespace(inner=np.arange(N), block=np.arange(N) * BLOCKS // N),
        sampled=SimpleNamespace(rate=one, origin=two),
    )
    return uneven(state, pulls, factor)  # type: ignore[arg-type]


def pulled(seed: int, places: Array, sigma: float = 1.0) -> Array:
    """(N, D) pulls of samples that see places (N, D) about their mean, with noise sigma each."""
    rng = np.random.default_rng(seed)
    return (places - places.mean(axis=0) + sigma * rng.standard_t(5.0, (N, D))) / N


@pytest.mark.parametrize("drive", ["time", "|ω|", "|a|"])
def test_places_that_follow_a_drive_are_told_with_their_spread(drive: str) -> None:
    vector = np.random.default_rng(3).normal(size=(N, 3))
    size = np.linalg.norm(vector, axis=1)
    driver = np.linspace(-1.0, 1.0, N) if drive == "time" else np.argsort(np.argsort(size)) / N
    places = np.zeros((N, D))
    places[:, 2] = 0.5 * driver / np.std(driver)
    kind = {"|ω|": {"rate": vector}, "|a|": {"force": vector}}.get(drive, {})
    found = asked(pulled(1, places, 0.3), **kind)
    assert found is not None
    assert found.driver == drive
    assert found.p < 1e-3
    # Four parts of an even drive hold 0.97 of its sd, twelve nearly all.
    assert 0.9 < found.spread[2] / 0.5 < 1.05
    assert np.delete(found.spread, 2).max() < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("loop", [True, False])
def test_a_board_that_bows_with_its_chips_is_not_known_to_its_sd(loop: bool) -> None:
    """Its chips tilt by the slope of the bow: no single IMU's place said so, and positions were
    five stated sds off with exit code 0, without the search too."""
    rng = np.random.default_rng(1)
    board = read_board("mimu4444_corners")
    parts = made_board(board.positions, board.rotations, board.imus, PLAN, rng)
    made = odd_log(parts, bowing_and_tilting, PLAN, rng)
    run = calibrate_array(made.recording, ArrayRequest(board, loop=loop), print)
    if loop:
        assert run.loop is not None
        assert "positions against time" in [u.name for u in run.loop.unexplained]
    else:
        assert "positions against time" in [one.name for one in run.outcome.left if one.beyond]
    assert run.outcome.exit_code == 5
    off = (run.total.mean - made.positions)[1:].ravel()
    assert np.abs(off / np.sqrt(np.diag(run.total.covariance))).max() < 3.0
