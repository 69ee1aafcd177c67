"""Motions that are offered obey mechanics, and a board in them reads what a rigid body feels."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.calibrators.array.separate import motion_plan
from imucalib.calibrators.array.separate.menu import SAMPLES, SECONDS, MenuMotion, menu, times
from imucalib.calibrators.array.separate.motion_plan import _moved
from imucalib.units import STANDARD_GRAVITY

Array = NDArray[np.float64]
ALL = menu(35.0)
STEP = 1e-5
DEG = np.pi / 180.0


def named(how: str, axis: str = "", fast: str = "1000") -> MenuMotion:
    (found,) = [m for m in ALL if how in m.words[1] and axis in m.words[0] and fast in m.words[2]
                and ("shaken" in how or "shaken" not in m.words[1])]  # fmt: skip
    return found


def test_what_is_faster_than_the_gyros_is_not_offered() -> None:
    """A fifth is kept free below the end of the range."""
    assert len(ALL) == 22
    assert len(menu(1201.0 * DEG)) == 22
    assert len(menu(1199.0 * DEG)) == len(menu(361.0 * DEG)) == 11
    assert menu(359.0 * DEG) == ()
    assert {m.words[2] for m in menu(400.0 * DEG)} == {"300 deg/s", "300 deg/s at most"}


@pytest.mark.parametrize("one", ALL, ids=[" ".join(m.words) for m in ALL])
def test_the_spin_is_the_rates_slope(one: MenuMotion) -> None:
    t = np.linspace(0.0, SECONDS, 50)
    slope = (one.at(t + STEP).rate - one.at(t - STEP).rate) / (2.0 * STEP)
    np.testing.assert_allclose(one.at(t).spin, slope, rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize("one", [m for m in ALL if m.words[0] != "all"],
                         ids=lambda m: " ".join(m.words))  # fmt: skip
def test_gravity_stands_still_while_the_board_turns(one: MenuMotion) -> None:
    """du/dt = -ω × u in the board's axes; the axis of turning is level."""
    t = np.linspace(0.0, SECONDS, 50)
    slope = (one.at(t + STEP).force - one.at(t - STEP).force) / (2.0 * STEP)
    at = one.at(t)
    np.testing.assert_allclose(slope, -np.cross(at.rate, at.force), rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(at.force, axis=1), STANDARD_GRAVITY)
    axis = np.array([one.words[0] == a for a in "xyz"], float)
    np.testing.assert_allclose(at.rate @ (1.0 - axis), 0.0)
    np.testing.assert_allclose(at.force @ axis, 0.0, atol=1e-12)


def test_rates_and_forces_are_as_large_as_the_words_say() -> None:
    t = np.linspace(0.0, SECONDS, 20_001)
    assert (named("steadily", "y").at(t).rate[:, 1] == 1000.0 * DEG).all()
    swung = named("to and fro, 3 times", "z").at(t)
    assert swung.rate.max() == pytest.approx(1000.0 * DEG)
    # Fifteen periods in five seconds: two zeros each.
    assert np.sum(np.diff(np.sign(swung.rate[:, 2])) != 0) == 30
    twisted, shaken = named("twisted by hand").at(t), named("twisted by hand and shaken").at(t)
    rms = np.sqrt(np.mean(np.sum(twisted.rate**2, axis=1)))
    # Six tones an axis, each of a root sixth of the peak.
    assert rms == pytest.approx(1000.0 * DEG * np.sqrt(3.0 / 2.0), rel=0.1)
    np.testing.assert_allclose(np.linalg.norm(twisted.force, axis=1), STANDARD_GRAVITY)
    assert np.std(shaken.force - twisted.force) == pytest.approx(15.0 / np.sqrt(2.0), rel=0.1)


def test_samples_stand_in_runs_of_neighbours_over_the_piece() -> None:
    t = times(0.004)
    assert len(t) == SAMPLES
    np.testing.assert_allclose(t[:9], [*(0.004 * np.arange(8)), 5.0 / 12.0])
    assert t[-1] == pytest.approx(SECONDS * 11.0 / 12.0 + 7 * 0.004)


def test_a_board_in_a_motion_reads_what_a_rigid_body_feels(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """s + ω × (ω × r) + dω/dt × r, without noise; the jerk is its slope in time."""
    t = np.sort(np.random.default_rng(0).uniform(0.0, 0.02, 30))
    one, r = named("to and fro, 1 time", "x").at(t), np.array([[0, 0, 0], [0.02, -0.01, 0.03]])
    seen = {}

    def kept(readings: object, weights: object, places: Array, rate: Array) -> object:
        seen.update(readings=readings, weights=weights)
        return SimpleNamespace(rate=rate, spin=one.spin, force=readings.acceleration)  # type: ignore[attr-defined]

    monkeypatch.setattr(motion_plan, "fit_samples", kept)
    monkeypatch.setattr(motion_plan, "board_motion", lambda **named: named)
    monkeypatch.setattr(motion_plan, "replace", lambda state, **changed: changed)
    noise = SimpleNamespace(weight=lambda jerk, speed: speed)
    state = SimpleNamespace(
        setup=SimpleNamespace(triads=2, imus=("a", "b"), board=SimpleNamespace(rotations=None)),
        r=r, noise=(noise, noise), motion=SimpleNamespace(age=None),
    )  # fmt: skip
    made = _moved(state, one, t, np.random.default_rng(1))  # type: ignore[arg-type]
    felt = one.force[:, None] + np.cross(one.spin[:, None], r)
    felt = felt + np.cross(one.rate[:, None], np.cross(one.rate[:, None], r))
    np.testing.assert_allclose(seen["readings"].acceleration, felt)
    np.testing.assert_allclose(seen["readings"].rate, np.repeat(one.rate[:, None], 2, axis=1))
    np.testing.assert_allclose(seen["weights"].rate, np.linalg.norm(one.rate, axis=1))
    motion = made["motion"]  # type: ignore[index]
    np.testing.assert_allclose(motion["jerk"][0], (felt[1] - felt[0]) / (t[1] - t[0]))
    # Of what follows the recording: drifts go on.
    assert (motion["order"] > 1.0).all()
