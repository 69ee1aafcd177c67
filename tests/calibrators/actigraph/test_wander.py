"""Worn sensors whose bias wanders: what is planted is named, and noise is named as noise.

The recordings come from plain numpy, the equations written anew (`tests/worlds/worn_walk.py`).
"""

from __future__ import annotations

from functools import cache
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from gates.bounds import at_most
from imucalib.calibrators.actigraph.request import ActigraphRequest

WANTED = ActigraphRequest()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "noise"),
    [
        ("temperature_bias", "walk 2 h"),
        ("temperature_scale", "walk 12 h"),
        ("bias_drift", "walk 2 h"),
        ("bias_step", "walk 10 min"),
        ("cubic", "walk 12 h"),
    ],
)
def test_an_effect_under_a_walk_is_named(worn: ModuleType, effect: str, noise: str) -> None:
    case = worn.Case(noise, effect, 14.0, 31)
    result = case.solved(WANTED)
    loop = result.loop
    names = {n.partition("@")[0] for s in loop.steps[:1] for n in (s.effect, *s.aliases)}
    assert effect in names
    assert len(loop.steps) == 1
    told = case.solved(ActigraphRequest(declare=(case.oracle_name(),), only=("warm_up",)))
    assert case.error(result.final) <= 1.3 * case.error(told.final)
    assert case.error(result.final) < 0.8 * case.error(result.base)
    assert loop.difference.gain > 0.0
    assert loop.difference.likely


@pytest.mark.slow
@pytest.mark.parametrize("mg", [5.0, 10.0, 20.0, 40.0])
def test_a_step_of_any_size_is_named(worn: ModuleType, mg: float) -> None:
    """The block that holds its moment cannot say when: it takes no part in the judgement."""
    case = worn.Case("walk 2 h", "bias_step", 1.0, 31)
    aim = mg / float(np.abs(case.size).max())
    result = worn.Case("walk 2 h", "bias_step", aim, 31).solved(WANTED)
    assert [s.effect.partition("@")[0] for s in result.loop.steps] == ["bias_step"]
    at = float(result.loop.steps[0].effect.partition("@")[2].removesuffix("s"))
    inside = np.sort(np.append(case.time, at))
    moment = 0.57 * worn.SPAN
    assert np.sum((inside > min(at, moment)) & (inside < max(at, moment))) <= 2
    assert result.loop.verdict == "explained"


def of(worn: ModuleType, monkeypatch: pytest.MonkeyPatch, effect: Any, aim: float) -> Any:
    """A recording with an effect (direction, °C from 25, share of time, sizes) -> mg."""
    monkeypatch.setitem(worn.EFFECTS, "planted", effect)
    return worn.Case("white", "planted", aim, 3)


def test_a_swing_of_seven_hours_is_followed(
    worn: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No effect has its period: to the noise it is a walk, whose course is the sensor's."""

    def swing(x: Any, t: Any, u: Any, c: Any) -> Any:
        return c * np.sin(2.0 * np.pi * 144.0 / 14.0 * u)[:, None]

    result = (case := of(worn, monkeypatch, swing, 25.0)).solved(WANTED)
    assert result.loop.wander.followed
    assert case.error(result.final) < 0.7 * case.error(result.base)


@pytest.mark.slow
@pytest.mark.parametrize(("limit", "refused"), [(0.93, True), (0.95, False)])
def test_readings_at_a_limit_stop_no_run(
    worn: ModuleType, monkeypatch: pytest.MonkeyPatch, limit: float, refused: bool
) -> None:
    """Beyond its limit the axis reads the same whatever the force is: a fit that follows it has no
    inverse, at once or once the noise is that beside it."""

    def limited(x: Any, t: Any, u: Any, c: Any) -> Any:
        return 1e3 * np.eye(3)[2] * (np.clip(x, -limit, limit) - x)

    monkeypatch.setattr(worn, "strength", lambda *_: 30.0)
    loop = of(worn, monkeypatch, limited, 30.0).solved(WANTED).loop
    assert loop.verdict != "nothing missing"
    assert any("no inverse" in why for _, why in loop.rejected) <= refused


NOISES = ("white", "walk 10 min", "walk 2 h", "walk 12 h", "t3")


@cache
def _without_effect(worn: ModuleType, noise: str, seed: int) -> Any:
    return worn.Case(noise, "", 0.0, 500 + seed).solved(WANTED)


@pytest.mark.slow
@pytest.mark.parametrize("noise", NOISES)
def test_noise_is_no_effect(worn: ModuleType, noise: str) -> None:
    for seed in range(4):
        result = _without_effect(worn, noise, seed)
        assert not (result.loop.steps and result.loop.verdict == "explained")
        assert not result.loop.unexplained


@pytest.mark.slow
def test_noise_is_taken_for_an_effect_as_seldom_as_stated(worn: ModuleType) -> None:
    runs = [_without_effect(worn, noise, seed) for noise in NOISES for seed in range(8)]
    assert sum(bool(run.loop.steps) for run in runs) <= at_most(40, 0.05).most


@pytest.mark.slow
def test_a_walk_is_measured_and_stated(worn: ModuleType) -> None:
    """1 mg an axis, 2 h: seen in |a| as 1 mg beside 0.8 mg of scatter; the parameters cover it."""
    z, sizes, hours = [], [], []
    for seed in range(12):
        case = worn.Case("walk 2 h", "", 0.0, 700 + seed)
        result = case.solved(WANTED)
        truth = np.concatenate([case.bias, np.diag(case.gain) - 1.0])
        z.append((result.base.theta[:6] - truth) / result.base.sd[:6])
        sizes.append(result.loop.wander.size)
        hours.append(result.loop.wander.hours)
    assert 0.6 < np.median(sizes) < 1.4
    assert 0.5 < np.median(hours) < 8.0
    assert 0.7 < np.std(z) < 1.25
