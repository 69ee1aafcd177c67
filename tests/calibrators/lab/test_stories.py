"""Benches with an undeclared effect must end with it named, or in the set of those that these
positions cannot tell apart; clean benches must end with nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gates.bounds import at_most
from imucalib.calibrators.lab.bench import position_observations
from imucalib.calibrators.lab.calibrate import LabResult, LabSettings, calibrate
from imucalib.calibrators.lab.conventions import Conventions
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import run_lab
from imucalib.calibrators.lab.simulation import BenchPlan, simulated_table
from imucalib.errors import UsageError
from imucalib.units import MG, STANDARD_GRAVITY


def bench(plan: BenchPlan, seed: int) -> LabResult:
    rng = np.random.default_rng(seed)
    table = simulated_table(plan, rng)
    data = position_observations(table, table.raw() * MG, Conventions(), STANDARD_GRAVITY)
    return calibrate(data, LabSettings())


def found(result: LabResult) -> set[str]:
    assert result.loop is not None
    return {n for s in result.loop.steps for n in (s.effect, *s.aliases)}


#: Effect, its planted values (the effect's units) and layout; each at least five times the noise.
PLANTED = [
    ("inclination_zero", (1.0,), "sweeps"),
    ("inclination_scale", (-1.5,), "sweeps"),
    ("tool_face_eccentricity", (0.9, 0.5), "rings"),
    ("tool_face_ellipticity", (0.6, -0.7), "rings"),
    ("axis_non_orthogonality", (0.8,), "rings"),
    ("quadratic", (6.0, -5.0, 6.0), "rings"),
    ("cubic", (12.0, -12.0, 12.0), "rings"),
    ("bias_drift", (12.0, -9.0, 12.0), "rings"),
    ("scale_drift", (14.0, 12.0, -14.0), "rings"),
    ("hysteresis", (6.0, 6.0, -6.0), "random"),
    ("temperature_bias", (1.2, -1.5, 1.2), "rings"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "values", "layout"), PLANTED)
def test_a_planted_effect_is_named(name: str, values: tuple[float, ...], layout: str) -> None:
    warm = (20.0, 30.0) if name.startswith("temperature") else None
    plan = BenchPlan(layout, 32, {name: values}, setting=(0.05, 0.05), temperature=warm)
    result = bench(plan, 5)
    assert name in found(result)
    loop = result.loop
    assert loop is not None
    assert result.error.held_out.final < result.error.held_out.base
    fit = loop.final
    if name in fit.model.names:
        part = fit.model.slices(fit.observations.context)[name]
        pull = (fit.theta[part] - np.array(values)) / fit.sd[part]
        assert np.all(np.abs(pull) < 4.5)


@pytest.mark.slow
def test_clean_benches_stay_clean() -> None:
    alarms = 0
    for seed in range(40):
        loop = bench(BenchPlan(setting=(0.1, 0.2)), 700 + seed).loop
        assert loop is not None
        alarms += bool(loop.steps or loop.unexplained or loop.records)
    assert alarms <= at_most(40, 0.05).most


@pytest.mark.slow
def test_structure_outside_the_catalogue_gets_a_formula_but_no_cause() -> None:
    """A third harmonic of the tool-face, which no effect of the catalogue is."""
    rng = np.random.default_rng(3)
    table = simulated_table(BenchPlan("rings", 48, setting=(0.05, 0.05)), rng)
    data = position_observations(table, table.raw() * MG, Conventions(), STANDARD_GRAVITY)
    reference = data.reference
    turned = np.zeros(reference.eta_size)
    shift = np.radians(0.8) * np.sin(3.0 * data.context["tool_face"])
    index = reference.directions(turned).index[:, 1]
    turned[index] = shift
    moved = reference.truth(turned) - reference.truth(0.0 * turned)
    result = calibrate(data.with_reading(data.reading + moved), LabSettings())
    assert result.loop is not None
    assert [s.effect for s in result.loop.steps] == ["shape@tool_face:tool_face:sine:120"]


@pytest.mark.slow
def test_an_absorbed_effect_is_listed_as_not_testable() -> None:
    loop = bench(BenchPlan(plant={"tool_face_zero": (2.0,)}), 9).loop
    assert loop is not None
    absorbed = {s.name for s in loop.scores if s.absorbed}
    assert "tool_face_zero" in absorbed
    assert not loop.steps


@pytest.mark.slow
@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_slip_of_a_factor_ten_is_told_before_anything_is_fitted(axis: str) -> None:
    table = simulated_table(BenchPlan(), np.random.default_rng(3))
    row = int(np.argmax(np.abs(table.columns[axis])))
    right = float(table.columns[axis][row])
    columns = {**table.columns, axis: table.columns[axis].copy()}
    columns[axis][row] *= 10.0
    slipped = replace(table, columns=columns)
    with pytest.raises(UsageError) as said:
        run_lab(slipped, LabRequest(unit="mg"))
    assert f"row {row + 1}" in str(said.value)
    assert f"--fix {row + 1}:{axis}={right:.10g}" in str(said.value)
    run = run_lab(slipped, LabRequest(unit="mg", auto_exclude=True))
    assert run.excluded == (f"row {row + 1}: excluded automatically (size of |a|)",)
    assert run.result.observations.n == table.n - 1
