"""Worn sensors of plain numpy: what is planted is named, noise is noise, likeness is no proof."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
import pytest

from gates.bounds import at_most
from imucalib.calibrators.actigraph.request import ActigraphRequest
from worlds import worn_walk
from worlds.worn_walk import Case

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
def test_an_effect_under_a_walk_is_named(effect: str, noise: str) -> None:
    case = Case(noise, effect, 14.0, 31)
    result = case.solved(WANTED)
    loop = result.loop
    names = {n.partition("@")[0] for s in loop.steps[:1] for n in (s.effect, *s.aliases)}
    assert effect in names
    assert len(loop.steps) == 1
    told = case.solved(ActigraphRequest(declare=(case.oracle_name(),), only=("warm_up",)))
    assert case.error(result.final) <= 1.3 * case.error(told.final)
    assert case.error(result.final) < 0.8 * case.error(result.base)
    assert loop.difference.holds


@pytest.mark.slow
@pytest.mark.parametrize("mg", [5.0, 10.0, 20.0, 40.0])
def test_a_step_of_any_size_is_named(mg: float) -> None:
    """The block that holds its moment cannot say when: it takes no part in the judgement."""
    case = Case("walk 2 h", "bias_step", 1.0, 31)
    aim = mg / float(np.abs(case.size).max())
    result = Case("walk 2 h", "bias_step", aim, 31).solved(WANTED)
    assert [s.effect.partition("@")[0] for s in result.loop.steps] == ["bias_step"]
    at = float(result.loop.steps[0].effect.partition("@")[2].removesuffix("s"))
    inside = np.sort(np.append(case.time, at))
    moment = 0.57 * worn_walk.SPAN
    assert np.sum((inside > min(at, moment)) & (inside < max(at, moment))) <= 2
    assert result.loop.verdict == "explained"


@pytest.mark.slow
def test_noise_is_taken_for_an_effect_as_seldom_as_stated() -> None:
    every = product(worn_walk.NOISES, range(500, 508))
    runs = [Case(noise, "", 0.0, seed).solved(WANTED) for noise, seed in every]
    assert sum(bool(run.loop.steps) for run in runs) <= at_most(40, 0.05).most


@pytest.mark.slow
def test_a_walk_is_measured_and_stated() -> None:
    """1 mg an axis, 2 h: seen in |a| as 1 mg beside 0.8 mg of scatter; the parameters cover it."""
    z, sizes, hours = [], [], []
    for seed in range(12):
        case = Case("walk 2 h", "", 0.0, 700 + seed)
        result = case.solved(WANTED)
        truth = np.concatenate([case.bias, np.diag(case.gain) - 1.0])
        z.append((result.base.theta[:6] - truth) / result.base.sd[:6])
        sizes.append(result.loop.drift.size)
        hours.append(result.loop.drift.hours)
    assert 0.6 < np.median(sizes) < 1.4
    assert 0.5 < np.median(hours) < 8.0
    assert 0.7 < np.std(z) < 1.25


#: (direction (n, 3), °C from 25 (n,), share of time from -1/2 (n,), draws (3, 3)) -> (n, 3) mg
Planted = Callable[[Any, Any, Any, Any], Any]


@pytest.fixture
def loop_of(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """(planted, λ or 0 for its own size, seed, noise) -> the loop of a recording with it."""

    def found(planted: Planted, aim: float, seed: int, noise: str = "white") -> Any:
        draws = np.random.default_rng((seed, 9)).standard_normal((3, 3))

        def one(x: Any, t: Any, u: Any, c: Any) -> Any:
            return (np.linalg.norm(c) if aim else 1.0) * planted(x, t, u, draws)

        monkeypatch.setitem(worn_walk.EFFECTS, "planted", one)
        return Case(noise, "planted", aim or 1.0, seed).solved(ActigraphRequest()).loop

    return found


def tilted(x: Any, c: Any) -> Any:
    """Angles between the axes: y takes x, z takes x and y."""
    return np.stack([0.0 * x[:, 0], c[0] * x[:, 0], c[1] * x[:, 0] + c[2] * x[:, 1]], axis=1)


def late(u: Any) -> Any:
    return (u > 0.07)[:, None]


CHANGES: dict[str, Planted] = {
    "scale": lambda x, t, u, c: late(u) * c[0] * x,
    "bias and scale": lambda x, t, u, c: late(u) * (c[0] + c[1] * x),
    "bias, scale and axes": lambda x, t, u, c: late(u) * (c[0] + c[1] * x + tilted(x, c[2])),
    "what the bias makes of the warmth": lambda x, t, u, c: late(u) * c[0] * (t[:, None] - 2.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("power", [0.5, 1.0])
def test_only_a_straight_drift_is_certainly_one(loop_of: Callable[..., Any], power: float) -> None:
    """With the root of time nine of fifteen were a certain drift, some with a certain warm-up."""
    loop = loop_of(lambda x, t, u, c: (u + 0.5)[:, None] ** power * c[0], 30.0, 3)
    certain = [step.effect for step in loop.steps if step.certain]
    assert certain == ["bias_drift"] * (power == 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4])
@pytest.mark.parametrize("change", CHANGES)
def test_what_changes_at_a_moment_is_no_certain_step_of_the_bias(
    loop_of: Callable[..., Any], change: str, seed: int
) -> None:
    loop = loop_of(CHANGES[change], 30.0, seed)
    assert loop.verdict != "nothing missing"
    assert not any(step.certain for step in loop.steps if step.effect.startswith("bias_step@"))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_step_of_the_bias_alone_stays_certain(loop_of: Callable[..., Any], seed: int) -> None:
    loop = loop_of(lambda x, t, u, c: late(u) * c[0], 30.0, seed)
    assert [step.effect.partition("@")[0] for step in loop.steps] == ["bias_step"]
    assert loop.steps[0].certain
    assert loop.unexplained == ()


def within_play(warm: Any, width: float) -> Any:
    """°C, moved only at the ends of a play."""
    at, found = warm[0], []
    for value in warm:
        at = min(max(at, value - width / 2.0), value + width / 2.0)
        found.append(at)
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize("width", [2.0, 3.5, 5.0])
def test_a_play_of_the_temperature_is_no_lag(loop_of: Callable[..., Any], width: float) -> None:
    loop = loop_of(lambda x, t, u, c: c[0] * within_play(t, width)[:, None], 30.0, 5)
    assert loop.steps[0].effect.startswith("thermal_hysteresis@")
    certain = {s.effect.partition("@")[0] for s in loop.steps if s.certain}
    assert certain <= {"thermal_hysteresis", "temperature_bias"}


@pytest.mark.slow
def test_a_converters_curve_is_found_and_removed() -> None:
    result = Case("white", "converter", 20.0, 31).solved(WANTED)
    assert result.loop is not None
    assert result.loop.curves
    assert result.error.held_out.final < 0.8 * result.error.held_out.base
