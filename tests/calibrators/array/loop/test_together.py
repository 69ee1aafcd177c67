"""A part of the motion takes at once what the whole ended with, where it shows every one itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibrators.array.loop.earlier import Earlier, start_state
from imucalib.calibrators.array.loop.refits.together import taken_together
from imucalib.calibrators.array.loop.search import Search, search
from imucalib.calibrators.array.loop.setup import array_setup
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.calibrators.array.loop.worth import refitted
from worlds.boards import BoardPlan
from worlds.twisted_board import BOARD, moved

LATE, SCALE = 1e-3, 0.02


@pytest.fixture(scope="module")
def begun() -> tuple[Search, ArrayState, Earlier]:
    """A search of gyros that are all late, of which imu2's reads 2 % too much."""
    moving, _ = moved(BoardPlan(twist_s=6.0), np.random.default_rng(3), late=LATE)
    rate = moving.rate.copy()
    rate[:, 2] *= 1.0 + SCALE
    setup = array_setup(replace(moving, rate=rate), BOARD, 120, robust=True)
    assert setup is not None
    state, earlier = start_state(setup, ()), Earlier()
    return search(state, frozenset(), np.random.default_rng(0), 99, earlier), state, earlier


def _taken(
    begun: tuple[Search, ArrayState, Earlier], *ended: str, left_out: frozenset[str] = frozenset()
) -> tuple[str, ...]:
    found, state, earlier = begun
    earlier.ended = ended
    several = taken_together(found, state, earlier, left_out)
    return () if several is None else tuple(s.name for s in several.scores)


def test_what_the_part_shows_is_fitted_jointly(begun: tuple[Search, ArrayState, Earlier]) -> None:
    found, state, earlier = begun
    names = earlier.ended = ("gyro_delay", "gyro_scale@imu2")
    several = taken_together(found, state, earlier, frozenset())
    assert several is not None
    assert tuple(s.name for s in several.scores) == names
    late, scale = several.state.terms[-2:]
    assert (late.name, scale.name) == names
    # A delay is in ms; one gyro of eight is judged against what all eight read together.
    assert late.theta == pytest.approx([1e3 * LATE], abs=0.05)
    assert scale.theta == pytest.approx(np.full(3, 100.0 * SCALE), abs=0.1)
    one = refitted(state, Earlier(), found.term(names[0]))
    assert one is not None
    by_steps = refitted(one, Earlier(), found.term(names[1]))
    assert by_steps is not None
    assert several.state.density == pytest.approx(by_steps.density, abs=1.0)


def test_what_it_does_not_show_is_left_to_its_own_search(
    begun: tuple[Search, ArrayState, Earlier],
) -> None:
    both = ("gyro_delay", "gyro_scale@imu2")
    assert _taken(begun, "flexing", *both) == both
    assert _taken(begun, "flexing", "gyro_scale@imu2") == ()
    assert _taken(begun, *both, left_out=frozenset(["gyro_delay"])) == ()
    assert _taken(begun) == ()


def test_the_last_one_has_no_twin_that_it_was_not_told_from(
    begun: tuple[Search, ArrayState, Earlier],
) -> None:
    assert _taken(begun, "gyro_scale@imu2", "gyro_delay") == ()


def test_what_has_a_step_goes_on_step_by_step(begun: tuple[Search, ArrayState, Earlier]) -> None:
    found, state, earlier = begun
    grown = refitted(state, Earlier(), found.term("gyro_delay"))
    assert grown is not None
    earlier.ended = ("gyro_delay", "gyro_scale@imu2")
    assert taken_together(found, grown, earlier, frozenset()) is None
