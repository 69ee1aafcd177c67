"""The motion that an array is told to record: a calibrated board with rivals, and after it."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from imucalib.calibrators.array.loop.closed_loop import MotionLoop
from imucalib.calibrators.array.separate.menu import SECONDS, menu, times
from imucalib.calibrators.array.separate.motion_block import motion_block, motions_of
from imucalib.calibrators.array.separate.motion_plan import motion_plans
from imucalib.errors import UnreadableInput
from worlds.array_stories import closed, planted_log


@cache
def ambiguous() -> MotionLoop:
    """A board with a gyro delay; that of each gyro is called a rival."""
    recording = planted_log("common gyro delay, 1 ms", 1)[0]
    loop = closed(recording)
    step = next(s for s in loop.steps if s.effect == "gyro_delay")
    return replace(loop, steps=(replace(step, aliases=("gyro_delay_each",)),))


def test_a_motion_of_the_menu_is_consistent() -> None:
    """dω/dt is the derivative of ω, and gravity keeps its size where nothing shakes."""
    t = np.linspace(0.3, 0.31, 101)
    for one in menu(35.0):
        made = one.at(t)
        numeric = np.gradient(made.rate, t, axis=0)[1:-1]
        np.testing.assert_allclose(made.spin[1:-1], numeric, rtol=1e-3, atol=1e-2)
        if "shaken" not in one.words[1]:
            np.testing.assert_allclose(np.linalg.norm(made.force, axis=1), 9.80665, rtol=1e-9)
        turned = np.gradient(made.force, t, axis=0)[1:-1]
        if one.words[0] != "all":  # fixed in the room: df/dt = -ω × f in the board
            along = -np.cross(made.rate, made.force)[1:-1]
            np.testing.assert_allclose(turned, along, rtol=1e-3, atol=1e-2)


def test_fast_motions_stay_off_the_menu_of_slow_gyros() -> None:
    assert len(menu(10.0)) == len(menu(35.0)) // 2
    assert times(0.01).max() < SECONDS


def test_an_ambiguity_gets_one_motion_and_its_length() -> None:
    (plan,) = motion_plans(ambiguous(), np.random.default_rng(0))
    made = plan.separation
    assert made.rivals == ("gyro_delay", "gyro_delay_each")
    assert ("gyro_delay_each", "gyro_delay") in made.pairs  # the common one is a part of the each
    assert ("gyro_delay", "gyro_delay_each") in made.never
    assert plan.seconds == SECONDS * len(made.plan)
    assert np.all(made.apart >= made.now)


def test_a_plan_comes_back_from_its_block() -> None:
    plans = motion_plans(ambiguous(), np.random.default_rng(0))
    block = json.loads(json.dumps(motion_block(plans), allow_nan=False))
    (read,) = motions_of(block, "here")
    made = plans[0].separation
    assert read.separation.never == made.never
    assert read.separation.informative == made.informative
    np.testing.assert_allclose(read.separation.apart, made.apart)
    block["ambiguities"][0].pop("never")
    with pytest.raises(UnreadableInput, match="damaged"):
        motions_of(block, "here")


def test_nothing_ambiguous_has_no_plan() -> None:
    loop = replace(ambiguous(), steps=tuple(replace(s, aliases=()) for s in ambiguous().steps))
    assert motion_plans(loop, np.random.default_rng(0)) == ()
