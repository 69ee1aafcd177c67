"""The stated covariance against the scatter of estimates, with tails and without; all samples."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.calibrators.array.board import Board
from imucalib.calibrators.array.estimate.covariance import (
    fitted_on_all,
    information,
    samples_taken,
    stated_covariance,
)
from imucalib.calibrators.array.loop.search import start_state
from imucalib.calibrators.array.loop.setup import array_setup
from imucalib.calibrators.array.loop.state import ArrayState
from worlds.boards import BoardPlan
from worlds.twisted_board import BOARD, fitted, moved

TWIST = BoardPlan(twist_s=6.0)


@pytest.mark.slow
@pytest.mark.parametrize("tails", [3.0, np.inf])
def test_errors_are_what_is_stated_with_tails_and_without(tails: float) -> None:
    plan = BoardPlan(twist_s=6.0, tails=tails)
    stated, weights = [], []
    for seed in range(12):
        state, true = fitted(plan, seed, 450)
        off = (state.r - true)[1:].ravel()
        for found, covariance in ((stated, stated_covariance(state)), (weights, state.covariance)):
            found.append(off @ np.linalg.solve(covariance, off) / off.size)
    z, plain = np.sqrt(np.mean(stated)), np.sqrt(np.mean(weights))
    # 12 sets of 21 numbers: a standard deviation of 0.045.
    assert 0.87 < z < 1.2
    if np.isfinite(tails):
        assert plain > 1.08 * z  # the weights alone say too little
    else:
        assert plain == pytest.approx(z, rel=0.1)


def _of_a_pair(state: ArrayState) -> float:
    """What two accelerometers tell over what their weights say, by hand.

    The motion leaves of two errors their difference e along the line, in units of the scale, and
    parts it so that (ν + 3) / 2 · Σ log(ν + r²) is least: in halves up to e = 2 √ν, beyond so that
    r₁ r₂ = ν. The score is (ν + 3) 2 e / (4 ν + e²) and (ν + 3) / e; its slope over itself / e.
    """
    noise, inner = state.noise[0], state.setup.inner
    scale = np.sqrt(noise.variance(np.linalg.norm(state.sampled.rate[inner], axis=1)))
    off = np.linalg.norm(state.sampled.off.acceleration[inner], axis=2)
    e2, nu = np.sum(off / scale, axis=1) ** 2, noise.freedom
    if not np.isfinite(nu):
        return 1.0
    halves = e2 < 4.0 * nu
    weight = np.where(halves, 2.0 / (4.0 * nu + e2), 1.0 / e2)
    slope = np.where(halves, weight * (4.0 * nu - e2) / (4.0 * nu + e2), -weight)
    return float(slope.mean() / weight.mean())


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 4])
def test_few_imus_tell_less_than_their_weights_say(count: int) -> None:
    """Of few chips' errors the motion takes a part, and may lay one on another."""
    flat = 0.02 * np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)], dtype=float)[:count]
    board = Board("flat", BOARD.imus[:count], flat, np.tile(np.eye(3), (count, 1, 1)))
    plan = BoardPlan(twist_s=8.0, tails=3.0)
    size, told = [], []
    for seed in range(16):
        state, true = fitted(plan, seed, 400, board)
        off, free = (state.r - true)[1:].ravel(), 3 * (count - 1)
        covariance = stated_covariance(state)[:free, :free]
        size.append(off @ np.linalg.solve(covariance, off) / free)
        due = _of_a_pair(state) if count == 2 else state.noise[0].information
        told.append(information(state)[0] / due)
    # 16 sets of 3 and of 9 numbers: standard deviations of 0.10 and 0.06.
    assert 0.8 < np.sqrt(np.mean(size)) < (1.24 if count == 2 else 1.15)
    if count == 2:
        assert np.mean(told) == pytest.approx(1.0, abs=0.03)
    else:
        assert 0.6 < np.median(told) < 0.92  # less than of three dimensions apiece


def test_all_informative_samples_take_part() -> None:
    moving, true = moved(TWIST, np.random.default_rng(3))
    setup = array_setup(moving, BOARD, 150, robust=True)
    assert setup is not None
    some = start_state(setup, ())
    assert samples_taken(moving, None) == len(moving.good)
    assert samples_taken(moving, 200) == 200
    every = fitted_on_all(some, moving, len(moving.good))
    assert np.array_equal(every.setup.rows[every.setup.inner], moving.good)
    few, all_ = (np.sqrt(np.diag(stated_covariance(s))) for s in (some, every))
    expected = np.sqrt(len(setup.inner) / len(moving.good))
    assert np.median(all_ / few) == pytest.approx(expected, rel=0.15)
    assert np.sqrt(np.mean(((every.r - true)[1:].ravel() / all_) ** 2)) < 1.5
