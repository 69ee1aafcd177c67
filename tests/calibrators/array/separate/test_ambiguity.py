"""What a motion that an array has recorded says of rivals, and what one that follows would add."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.calibrators.array.board import Board
from imucalib.calibrators.array.loop.catalogue import array_catalogue
from imucalib.calibrators.array.loop.state import ArrayState, settled
from imucalib.calibrators.array.loop.terms import Term
from imucalib.calibrators.array.loop.words import size_in_words
from imucalib.calibrators.array.separate import motion_plan
from imucalib.calibrators.array.separate.menu import SECONDS
from imucalib.calibrators.array.separate.motion_block import motion_block, motions_of
from imucalib.calibrators.array.separate.motion_plan import _ambiguity, motion_plans
from imucalib.errors import UnreadableInput
from worlds.boards import BoardPlan
from worlds.twisted_board import BOARD, fitted

FOUR = Board("four", BOARD.imus[:4], 0.02 * np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 1, 1)]),
             np.tile(np.eye(3), (4, 1, 1)), gyroscope_range=30.0)  # fmt: skip
RIVALS = [(n, array_catalogue()[n], None) for n in ("gyro_delay", "gyro_delay_each")]


@cache
def with_delay() -> ArrayState:
    """Gyros that are 2 ms late, and the delay found."""
    state, _ = fitted(BoardPlan(twist_s=4.0), 3, 100, FOUR, late=2e-3)
    one = np.ones(1)
    delay = Term("gyro_delay", RIVALS[0][1], None, np.eye(1), 0.0 * one, one)
    return settled(replace(state, terms=(delay,)))


def test_the_recording_says_of_an_effect_what_its_fit_does() -> None:
    """From the products alone: least squares of the base and the effect gives its size and sd
    again; a gyro's own delay explains as much, and half the readings weigh half."""
    state = with_delay()
    (term,) = state.terms
    assert term.theta[0] == pytest.approx(2.0, abs=0.2)
    without = replace(state, terms=())
    found = _ambiguity(without, term, RIVALS, 1.0)
    assert found.rivals == ("gyro_delay", "gyro_delay_each")
    assert [len(at) for at in found.blocks.values()] == [1, 4]
    assert found.first == 9
    p, own = found.products, np.append(found.own, found.blocks["gyro_delay"])
    theta = np.linalg.solve(p.gram[np.ix_(own, own)], p.along[own])
    typical = array_catalogue()["gyro_delay"].each[0].typical  # type: ignore[union-attr]
    assert theta[-1] * typical == pytest.approx(term.theta[0], rel=0.02)
    sd = np.sqrt(np.linalg.inv(p.gram[np.ix_(own, own)])[-1, -1]) * typical
    assert sd == pytest.approx(state.sd_of(term)[0], rel=0.05)
    each = np.concatenate([found.own, found.blocks["gyro_delay_each"]])
    explained = [p.along[at] @ np.linalg.solve(p.gram[np.ix_(at, at)], p.along[at])
                 for at in (own, each)]  # fmt: skip
    assert explained[1] == pytest.approx(explained[0], rel=0.01)
    # What is left is noise, one a number.
    assert (p.power - explained[0]) / found.dof == pytest.approx(1.0, abs=0.15)
    assert found.dof == pytest.approx(p.numbers - 9.0)

    half = _ambiguity(without, term, RIVALS, 2.0)
    data = np.zeros(len(p.gram))
    data[:9] = np.diag(p.gram)[:9] - 2.0 * np.diag(half.products.gram)[:9]
    np.testing.assert_allclose(p.gram[9:, 9:], 2.0 * half.products.gram[9:, 9:])
    # The drawing's prior is no reading: noise that neighbours share does not make it less.
    np.testing.assert_allclose(data[:9], -(3e-3**-2.0), rtol=1e-6)
    assert half.products.numbers == pytest.approx(p.numbers / 2.0)


def test_of_many_samples_some_stand_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    state = with_delay()
    without = replace(state, terms=())
    whole = _ambiguity(without, state.terms[0], RIVALS, 1.0)
    monkeypatch.setattr(motion_plan, "_READINGS", 200)
    monkeypatch.setattr(motion_plan, "_FEWEST", 40)
    some = _ambiguity(without, state.terms[0], RIVALS, 1.0)
    assert some.products.numbers == pytest.approx(whole.products.numbers)
    ratio = np.diag(some.products.gram)[9:] / np.diag(whole.products.gram)[9:]
    np.testing.assert_allclose(ratio, 1.0, atol=0.5)


def loop(state: ArrayState, *aliases: str, evidence: float = 50.0) -> SimpleNamespace:
    step = SimpleNamespace(effect="gyro_delay", aliases=aliases, evidence=evidence)
    scores = (SimpleNamespace(name="gyro_delay_each", evidence=40.0),)
    return SimpleNamespace(final=state, named=(step,), dispersion=1.0, first_scores=scores)


def test_one_motion_of_the_menu_is_told_and_how_long() -> None:
    (plan,) = motion_plans(loop(with_delay(), "gyro_delay_each"), np.random.default_rng(0))  # type: ignore[arg-type]
    made = plan.separation
    assert made.nats == {"gyro_delay": 50.0, "gyro_delay_each": 40.0}
    assert made.pairs == (("gyro_delay_each", "gyro_delay"),)
    assert made.never == (("gyro_delay", "gyro_delay_each"),)
    assert plan.seconds == SECONDS * len(made.plan)
    assert plan.motion is not None
    assert (made.apart >= made.now).all()
    nothing = loop(with_delay())
    assert motion_plans(nothing, np.random.default_rng(0)) == ()  # type: ignore[arg-type]
    unknown = loop(with_delay(), "no such effect", "gyro_delay_each@imu99")
    assert motion_plans(unknown, np.random.default_rng(0)) == ()  # type: ignore[arg-type]


def test_a_plan_comes_back_from_its_block() -> None:
    plans = motion_plans(loop(with_delay(), "gyro_delay_each"), np.random.default_rng(0))  # type: ignore[arg-type]
    block = json.loads(json.dumps(motion_block(plans), allow_nan=False))
    (read,) = motions_of(block, "here")
    made = plans[0].separation
    assert read.separation.never == made.never
    assert read.separation.informative == made.informative
    np.testing.assert_allclose(read.separation.apart, made.apart)
    block["ambiguities"][0].pop("never")
    with pytest.raises(UnreadableInput, match="damaged"):
        motions_of(block, "here")


def test_a_terms_size_is_told_by_one_three_or_the_rms() -> None:
    state = with_delay()
    (term,) = state.terms
    assert size_in_words(state, term).endswith("ms")
    assert "±" in size_in_words(state, term)
    each = replace(term, name="each", effect=RIVALS[1][1], live=np.eye(4)[:, :3],
                   value=np.array([3.0, 4.0, 12.0]), sd=np.ones(3))  # fmt: skip
    wide = replace(state, terms=(each,), covariance=np.eye(12))
    assert size_in_words(wide, each) == "6.5 ms rms, 3 of 4 determined"
    three = replace(FOUR.take([0, 1, 2]))
    few = SimpleNamespace(setup=SimpleNamespace(imus=three.imus), sd_of=lambda term: np.ones(3))
    short = replace(each, live=np.eye(3))
    assert size_in_words(few, short) == "3, 4, 12 ms"  # type: ignore[arg-type]
