"""Effects that nobody listed: no name is certain beside them, and they are told as something.

The recordings come from plain numpy, the equations written anew (`tests/worlds/worn_walk.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from imucalib.calibrators.actigraph.request import ActigraphRequest

#: (direction (n, 3), °C from 25 (n,), share of time from -1/2 (n,), draws (3, 3)) -> (n, 3) mg
Planted = Callable[[Any, Any, Any, Any], Any]


@pytest.fixture
def loop_of(worn: ModuleType, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """(planted, λ or 0 for its own size, seed, noise) -> the loop of a recording with it."""

    def found(planted: Planted, aim: float, seed: int, noise: str = "white") -> Any:
        draws = np.random.default_rng((seed, 9)).standard_normal((3, 3))

        def one(x: Any, t: Any, u: Any, c: Any) -> Any:
            return (np.linalg.norm(c) if aim else 1.0) * planted(x, t, u, draws)

        monkeypatch.setitem(worn.EFFECTS, "planted", one)
        return worn.Case(noise, "planted", aim or 1.0, seed).solved(ActigraphRequest()).loop

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


LEFT: dict[str, Planted] = {
    "warmth": lambda x, t, u, c: c[0] * x * (t[:, None] - 5.0) ** 2,
    "bend": lambda x, t, u, c: c[0] * x * u[:, None] ** 2,
}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("structure", LEFT)
def test_what_follows_a_driver_unlisted_is_told(
    loop_of: Callable[..., Any], structure: str, seed: int
) -> None:
    loop = loop_of(LEFT[structure], 30.0, seed)
    assert loop.verdict != "nothing missing"
    assert not any(step.certain for step in loop.steps)


def behind_play(warm: Any, width: float) -> Any:
    """°C, moved only at the ends of a play."""
    at, found = warm[0], []
    for value in warm:
        at = min(max(at, value - width / 2.0), value + width / 2.0)
        found.append(at)
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize("width", [2.0, 3.5, 5.0])
def test_a_play_of_the_temperature_is_no_lag(loop_of: Callable[..., Any], width: float) -> None:
    loop = loop_of(lambda x, t, u, c: c[0] * behind_play(t, width)[:, None], 30.0, 5)
    assert loop.steps[0].effect.startswith("thermal_hysteresis@")
    certain = {s.effect.partition("@")[0] for s in loop.steps if s.certain}
    assert certain <= {"thermal_hysteresis", "temperature_bias"}


def ahead_of_its_inside(warm: Any, hours: Any, minutes: float = 20.0) -> Any:
    """°C, of a case whose inside trails it by so many minutes."""
    grid = np.arange(hours[0], hours[-1], 1.0 / 60.0)
    inside, found = warm[0], []
    for value in np.interp(grid, hours, warm):
        inside += (value - inside) / minutes
        found.append(inside)
    return warm - np.interp(hours, grid, found)


@pytest.mark.slow
def test_what_the_rate_of_the_temperature_drives_is_no_lag(loop_of: Callable[..., Any]) -> None:
    """It was a certain temperature_bias beside a lag, or nothing at all."""
    loop = loop_of(lambda x, t, u, c: c[0] * ahead_of_its_inside(t, 144.0 * u)[:, None], 30.0, 5)
    assert {step.effect.partition("@")[0] for step in loop.steps} == {"temperature_rate"}
    assert loop.steps[0].certain
