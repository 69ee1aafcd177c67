"""Weeks with an undeclared effect must end with it named; clean weeks with nothing."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.calibrators.actigraph.calibrate import ActigraphResult, calibrate
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.actigraph.simulation import (
    Week,
    WeekPlan,
    code_steps,
    simulated_week,
)
from imucalib.core.effect import Context, Effect, Parameter, Response, Truth
from imucalib.units import MG, STANDARD_GRAVITY

Array = NDArray[np.float64]
DAYS = 4.0


def solved(week: Week, request: ActigraphRequest | None = None) -> ActigraphResult:
    return calibrate(week.runs, week.scanned, request or ActigraphRequest())


def knowing(week: Week, effect: str, extra: dict[str, Effect] | None = None) -> float:
    """Held-out error (mg) of one who knows which effect it is."""
    request = ActigraphRequest(declare=(effect,), loop=False, extra_effects=extra or {})
    return solved(week, request).error.held_out.final


def found_names(result: ActigraphResult) -> set[str]:
    assert result.loop is not None
    steps = result.loop.steps
    every = [name for s in steps for name in (s.effect, *s.aliases)]
    return {name.partition("@")[0] for name in every}


STORIES = {
    "temperature_bias": (0.8, -0.5, 1.2),
    "bias_step@155555s": (3.0, -2.0, 4.0),
    "cubic": (6.0, -5.0, 8.0),
    "thermal_lag@1.5h": (0.8, -0.5, 1.2),
    "bias_drift": (2.0, 1.0, -3.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("effect", STORIES)
def test_an_undeclared_effect_is_named_and_removed(effect: str) -> None:
    week = simulated_week(WeekPlan(days=DAYS, plant={effect: STORIES[effect]}), 3)
    result = solved(week)
    assert effect.partition("@")[0] in found_names(result)
    # In the block that is left out nobody can know when within it the bias jumped.
    error = result.error.final if "step" in effect else result.error.held_out.final
    assert error <= 1.3 * knowing(week, effect)
    assert result.error.held_out.final < 0.8 * result.error.held_out.base
    assert result.loop is not None
    assert result.loop.verdict == "explained"


def the_very_converter() -> Effect:
    """The planted curve itself, its size on each axis unknown."""
    shape = code_steps(1.0)

    def basis(truth: Truth, context: Context) -> Array:
        x = truth.force
        return np.asarray(np.eye(3) * MG * shape(x / STANDARD_GRAVITY)[..., None])

    def basis_dx(truth: Truth, context: Context) -> Array:
        x = truth.force
        out = np.zeros((*x.shape, 3, 3))
        step = 1e-6
        slope = (shape(x / STANDARD_GRAVITY + step) - shape(x / STANDARD_GRAVITY - step)) / 2 / step
        for axis in range(3):
            out[..., axis, axis, axis] = slope[..., axis] * MG / STANDARD_GRAVITY
        return out

    each = tuple(Parameter(f"planted_{a}", "mg", 1.0, 30.0) for a in "xyz")
    return Response("planted", "s", "y = x", "s", "s", each=each, basis=basis, basis_dx=basis_dx)


@pytest.mark.slow
def test_a_converters_curve_is_found_and_removed() -> None:
    week = simulated_week(WeekPlan(days=DAYS, curve=code_steps(2.4)), 4)
    result = solved(week)
    assert result.loop is not None
    assert result.loop.curves
    oracle = knowing(week, "planted", {"planted": the_very_converter()})
    assert result.error.held_out.final <= 1.3 * oracle


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_a_clean_week_stays_as_it_is(seed: int) -> None:
    result = solved(simulated_week(WeekPlan(days=2.0), 100 + seed))
    assert result.loop is not None
    assert not result.loop.steps
