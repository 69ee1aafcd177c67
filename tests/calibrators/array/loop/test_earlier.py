"""What a search owes to earlier ones changes what it costs, not what it finds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibrators.array.loop import state as fits
from imucalib.calibrators.array.loop.declared import declared_term
from imucalib.calibrators.array.loop.earlier import Earlier, drawn_state
from imucalib.calibrators.array.loop.refits.twins import _twins
from imucalib.calibrators.array.loop.setup import part_of
from imucalib.calibrators.array.loop.state import Behind, settled
from worlds.boards import BoardPlan
from worlds.twisted_board import fitted

PLAN = BoardPlan(twist_s=4.0, tails=4.0)


def test_a_half_that_begins_at_the_whole_ends_at_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    whole, _ = fitted(PLAN, 5, 80)
    grown = settled(replace(whole, terms=(declared_term(whole, "gyro_scale"),)))
    half = part_of(whole.setup, whole.setup.first)
    own = settled(drawn_state(half, ()))
    term = declared_term(own, "gyro_scale")
    rounds = []
    made = fits.moved_motion
    monkeypatch.setattr(fits, "moved_motion", lambda *args: rounds.append(1) or made(*args))
    alone = settled(replace(own, terms=(term,)))
    cost = len(rounds)
    earlier = Earlier()
    earlier.kept(grown)
    begun = earlier.begun(replace(own, terms=(term,)))
    assert np.array_equal(begun.r, grown.r)
    assert not np.array_equal(begun.r, alone.r)
    led = settled(begun)
    assert len(rounds) - cost <= cost
    off = (led.r - alone.r)[1:].ravel()
    precision = np.linalg.inv(alone.covariance)[: off.size, : off.size]
    assert off @ precision @ off < 0.4
    far = (grown.r - alone.r)[1:].ravel()
    assert far @ precision @ far > 2.0
    assert led.noise[1].sigma == pytest.approx(alone.noise[1].sigma, rel=0.01)


def test_other_terms_begin_where_they_are() -> None:
    state, _ = fitted(PLAN, 5, 80)
    earlier = Earlier()
    assert earlier.begun(state) is state
    assert earlier.kept(state) is state
    assert np.array_equal(earlier.begun(state).r, state.r)


def test_chance_is_drawn_once_for_one_noise() -> None:
    state, _ = fitted(PLAN, 5, 80)
    earlier, draws = Earlier(), iter(range(9))

    def drawn() -> np.ndarray:
        return np.full(3, float(next(draws)))

    one, two = state.noise
    alike = replace(state, noise=(replace(one, sigma=1.1 * one.sigma), two))
    other = replace(state, noise=(one, replace(two, sigma=2.0 * two.sigma)))
    found = [earlier.chance(s, drawn)[0] for s in (state, alike, other, state, other)]
    assert found == [0.0, 0.0, 1.0, 0.0, 1.0]


def test_nothing_more_is_asked_of_a_fit_that_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    state, _ = fitted(PLAN, 5, 80)
    monkeypatch.setattr(fits, "_RUNAWAY", 0.0)
    asked = []
    monkeypatch.setattr(fits, "_shaped", lambda s: asked.append(1) or s.noise)
    lost = settled(state, lost=True)
    assert not lost.converged
    assert not asked
    settled(state)
    assert asked


def test_a_fit_that_stays_behind_is_given_up() -> None:
    """Asked for more than it can have, it ends at once; asked for what it has, it is whole."""
    late, _ = fitted(PLAN, 5, 80, late=1e-3)
    grown = settled(replace(late, terms=(declared_term(late, "gyro_delay"),)))
    start = replace(late, r=late.setup.board.drawn)
    with pytest.raises(Behind):
        settled(start, shaped=False, least=grown.density)
    again = settled(start, shaped=False, least=late.density)
    assert again.density == pytest.approx(late.density, abs=1.0)


def test_a_twin_that_stays_behind_is_no_rival() -> None:
    """One that would have to be 200 nats better than it is is neither a fit nor a lost one."""
    late, _ = fitted(PLAN, 5, 80, late=-3e-3)
    grown = settled(replace(late, terms=(declared_term(late, "gyro_delay"),)))
    twin = "common_accelerometer_low_pass"
    near = _twins(grown, "gyro_delay", [twin], 3.0)[twin]
    assert near is not None
    assert near.converged
    assert not _twins(grown, "gyro_delay", [twin], near.density - grown.density - 200.0)
