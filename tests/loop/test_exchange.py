"""A rival that leads once what was missing beside it is in the model takes the place of a name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imucalib.calibrators.lab.calibrate import LabSettings
from imucalib.calibrators.lab.position_table import read_position_table
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import LabRun, run_lab
from imucalib.loop.found import Step
from imucalib.loop.records import extended
from imucalib.loop.rivals.exchange import exchanged
from worlds.plain_bench import Bench, Plan

#: A square of the response and a sag of the holder: while the square was missing, the sag's trace
#: was told as `cross_axis`, with the sag among those that would do (2.37 -> 2.86 mg off).
SHEET = Plan(40067002, (("quadratic", 12.0), ("inclination_sag", 12.0)))


def calibrated(folder: Path, settings: LabSettings) -> LabRun:
    table = read_position_table(Bench(SHEET).write(folder / "sheet.csv"))
    return run_lab(table, LabRequest(unit="mg", settings=settings))


def step(name: str, *rivals: str) -> Step:
    return Step(name, 0.003, 299, 9.0, (), rivals)


@pytest.mark.parametrize("told", ["cross_axis", "inclination_sag"])
def test_what_leads_beside_the_rest_takes_the_place(told: str, tmp_path: Path) -> None:
    fit = calibrated(tmp_path, LabSettings(loop=False, declare=("quadratic", told))).result.final
    (other,) = {"cross_axis", "inclination_sag"} - {told}
    before = step(told, "inclination_zero", other, "wandering_bias")
    after, (found,) = exchanged(fit, (before,), extended)
    assert found.effect == "inclination_sag"
    assert set(after.model.names) == {*fit.model.names} - {told} | {"inclination_sag"}
    assert (found is before) == (told == "inclination_sag")
    # Eight nats behind, the other stays a rival, as does what has no model of its own.
    assert {found.effect, *found.aliases} == {before.effect, *before.aliases}
    assert found.p == before.p


def test_what_is_ten_nats_behind_by_then_is_no_rival(tmp_path: Path) -> None:
    fit = calibrated(tmp_path, LabSettings(loop=False, declare=("quadratic", "cubic"))).result.final
    before = step("cubic", "inclination_sag", "wandering_bias")
    _, (found,) = exchanged(fit, (before,), extended)
    assert (found.effect, found.aliases) == ("inclination_sag", ("wandering_bias",))


def test_a_name_that_is_not_in_the_model_or_has_no_rival_stays(tmp_path: Path) -> None:
    fit = calibrated(tmp_path, LabSettings(loop=False, declare=("quadratic",))).result.final
    steps = (step("cross_axis", "inclination_sag"), step("quadratic"))
    after, found = exchanged(fit, steps, extended)
    assert after is fit
    assert found == steps


def test_two_effects_end_under_their_own_names(tmp_path: Path) -> None:
    run = calibrated(tmp_path, LabSettings())
    loop = run.result.loop
    assert loop is not None
    assert {s.effect for s in loop.steps} == {"inclination_sag", "quadratic"}
    assert loop.verdict == "explained"
    assert loop.difference is not None
    assert loop.difference.nats_low > 10.0
    assert np.isfinite(run.result.final.theta).all()
