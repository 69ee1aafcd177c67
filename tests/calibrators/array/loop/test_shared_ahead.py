"""What neighbours' noise would leave beside one effect more is foreseen without the refit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibrators.array.loop.earlier import Earlier, start_state
from imucalib.calibrators.array.loop.noise_tests import shared_by_neighbours
from imucalib.calibrators.array.loop.search import Search, search
from imucalib.calibrators.array.loop.setup import array_setup
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.calibrators.array.loop.worth import refitted, shared_ahead
from imucalib.units import DEG
from worlds.boards import BoardPlan
from worlds.twisted_board import BOARD, moved


def searched(memory: float) -> tuple[Search, ArrayState]:
    """imu2's gyro reads 1 % too much, and all gyros have noise of which neighbours share this."""
    rng = np.random.default_rng(11)
    moving, _ = moved(BoardPlan(twist_s=6.0), rng)
    rate = moving.rate.copy()
    rate[:, 2] *= 1.01
    walk, new = np.zeros(rate.shape), rng.normal(size=rate.shape)
    for k in range(1, len(walk)):
        walk[k] = memory * walk[k - 1] + np.sqrt(1.0 - memory**2) * new[k]
    setup = array_setup(replace(moving, rate=rate + 0.3 * DEG * walk), BOARD, 200, robust=True)
    assert setup is not None
    state = start_state(setup, ())
    return search(state, frozenset(), np.random.default_rng(0), 99, Earlier()), state


@pytest.mark.parametrize("memory", [0.0, 0.6, 0.9])
def test_it_is_what_the_refit_has(memory: float) -> None:
    """Before, the scale that nobody took out passes for noise with memory itself."""
    found, state = searched(memory)
    name = "gyro_scale@imu2"
    ahead = shared_ahead(state, found.entries[name], found.beside(name))
    fit = refitted(state, Earlier(), found.term(name))
    assert fit is not None
    after = shared_by_neighbours(fit, gyro=True)
    assert shared_by_neighbours(state, gyro=True) > 1.2 * after
    # It refuses before a refit, so it must not be much more than that has.
    assert ahead == pytest.approx(after, rel=0.06)
