"""Benches, simulated and measured: what nobody declared is named, clean ones end with nothing."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gates.bounds import at_most
from imucalib.calibrators.lab.bench import position_observations
from imucalib.calibrators.lab.calibrate import LabResult, calibrate
from imucalib.calibrators.lab.dial import dial_of
from imucalib.calibrators.lab.errors import attitude_errors, rms, worst
from imucalib.calibrators.lab.files import LabFiles, calibrate_files
from imucalib.calibrators.lab.position_table import read_position_table
from imucalib.calibrators.lab.request import LabRequest, as_published
from imucalib.calibrators.lab.run import LabRun, run_lab
from imucalib.calibrators.lab.simulation import BenchPlan, simulate_table
from imucalib.core.angle_conventions import Conventions
from imucalib.posterior.held_out import predict_fitted
from imucalib.units import MG, STANDARD_GRAVITY
from worlds.places import ROOT, SAMPLES


def bench(plan: BenchPlan, seed: int) -> LabResult:
    rng = np.random.default_rng(seed)
    table = simulate_table(plan, rng)
    data = position_observations(table, table.raw() * MG, Conventions(), STANDARD_GRAVITY)
    return calibrate(data, LabRequest())


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
    table = simulate_table(BenchPlan("rings", 48, setting=(0.05, 0.05)), rng)
    data = position_observations(table, table.raw() * MG, Conventions(), STANDARD_GRAVITY)
    reference = data.reference
    turned = np.zeros(reference.eta_size)
    shift = np.radians(0.8) * np.sin(3.0 * data.context["tool_face"])
    index = reference.directions(turned).index[:, 1]
    turned[index] = shift
    moved = reference.truth(turned) - reference.truth(0.0 * turned)
    result = calibrate(data.set_reading(data.reading + moved), LabRequest())
    assert result.loop is not None
    assert [s.effect for s in result.loop.steps] == ["shape@tool_face:tool_face:sine:120"]


#: What the acceptance benchmark's worlds lack: of the sensor, mg at x (n, 3) in g.
PLANTED = {
    "product_across": (3, lambda x, c, p: p * np.roll(x, -1, axis=1) * np.roll(x, 1, axis=1)),
    "squares_across": (
        3,
        lambda x, c, p: p * (np.roll(x, -1, axis=1) ** 2 - np.roll(x, 1, axis=1) ** 2),
    ),
    "third_degree": (
        1,
        lambda x, c, p: p * np.outer(x[:, 0] ** 2 * x[:, 1], [0.0, 0.0, 1.0]),
    ),
    "scale_cycle": (1, lambda x, c, p: p * x * np.sin(2 * np.pi * c.row / 13.3 + 1.0)[:, None]),
}


@pytest.fixture
def sheet_with(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[str], Path]:
    """A sheet of 36 rows in plain numpy with one effect, twenty times its noise."""
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks" / "closed_loop"))
    defects, world, bench = map(importlib.import_module, ("defects", "world", "bench"))
    slip = 1, lambda c, p: (0.0 * c.order, p[0] * (c.row >= c.at))
    for name, (count, act) in {**PLANTED, "slip": slip}.items():
        monkeypatch.setitem(defects.NUMBER, name, count)
        monkeypatch.setitem(defects.LARGEST, name, np.inf)
        every = defects.EVERY_SENSOR if name in PLANTED else defects.EVERY_DIAL
        monkeypatch.setitem(every, name, (count, np.inf, act))

    def made(name: str) -> Path:
        return Path(bench.Table(world.Recipe("bench", "", 1, {name: 20.0})).write(tmp_path)[1])

    return made


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "due"),
    [
        ("product_across", "product_across"),
        ("squares_across", "squares_across"),
        ("third_degree", "third_degree@z"),
        ("scale_drift", "scale_drift"),
        ("thermal_lag", "thermal_lag@4rows"),
        ("swing", "cycle@15rows"),
        ("scale_cycle", "scale_cycle@13.33rows"),
        ("slip", "slip@record23:z"),
    ],
)
def test_one_effect_is_named_and_corrected(
    name: str, due: str, sheet_with: Callable[[str], Path]
) -> None:
    run = run_lab(read_position_table(sheet_with(name)), LabRequest(unit="mg"))
    assert run.result.loop is not None
    (step,) = run.result.loop.steps
    assert (step.effect, step.certain) == (due, True)
    held = run.outcome.errors[0].held_out
    assert held.final < 0.85 * held.base


REPAIR = ((10, "y", -58593.0),)
TRAIN = tuple(range(1, 21))


def paper(request: LabRequest) -> LabRun:
    return run_lab(read_position_table(SAMPLES / "paper_table_1.csv"), request)


@pytest.fixture(scope="module")
def repaired() -> LabRun:
    return paper(LabRequest(gravity=9.8061, fixes=REPAIR))


@pytest.mark.slow
def test_the_dial_is_named_and_the_sensor_is_not_blamed(repaired: LabRun) -> None:
    loop = repaired.result.loop
    assert loop is not None
    assert loop.steps[0].effect == "inclination_zero"
    assert not loop.records
    assert not loop.slips
    dial = dial_of(repaired.result, np.array([50.0]))
    assert dial.shift[0] - dial.half[0] <= 1.37 <= dial.shift[0] + dial.half[0]
    there = {s.name: s.probability for s in loop.scores}
    assert all(there[name] < 0.5 for name in ("quadratic", "cubic", "bias_drift", "cross_axis"))
    # 0.40 deg (docs/lab.md); what hands usually do takes part.
    assert any(
        re.search(r"Tool-face scatters by 0\.(39|40) deg", a) for a in repaired.outcome.advice
    )


@pytest.mark.slow
def test_held_out_errors_reach_the_marks(repaired: LabRun) -> None:
    """But for row 2, which was set off: corrected by the paper it stands 0.58 deg further from its
    dial than row 3 does (its Table 2: 10.465 for 10 and 19.887 for 20 deg)."""
    left_out = attitude_errors(repaired.result.splits[0].final, Conventions())
    set_off = left_out.inclination[1] - left_out.inclination[2]
    assert set_off == pytest.approx(10.465 - 10.0 - (19.887 - 20.0), abs=0.2)
    others = np.delete(left_out.inclination, 1)
    assert worst(others) <= 0.40
    assert rms(others) <= 0.17
    assert worst(left_out.tool_face) <= 0.90
    assert rms(left_out.tool_face) <= 0.40
    assert rms(attitude_errors(predict_fitted(repaired.result.final), Conventions()).norm) <= 1.3


def test_two_thirds_of_the_table_blame_no_record() -> None:
    """Rows 1-20 at standard gravity. Their y scatters more than x and z."""
    run = paper(LabRequest(fixes=REPAIR, train=TRAIN))
    loop = run.result.loop
    assert loop is not None
    assert not loop.records
    assert not loop.slips
    assert not any(step.certain for step in loop.steps)
    test = run.result.splits[-1]
    assert test.final.rms() < 1.01 * test.base.rms()


@pytest.mark.slow
def test_as_published_is_the_printed_table_2() -> None:
    run = paper(as_published(LabRequest(fixes=REPAIR)))
    printed = np.genfromtxt(
        ROOT / "tests" / "goldens" / "paper_table_2.csv", delimiter=",", skip_header=2
    )
    fit, whole = run.result.final, run.result.observations
    corrected = fit.model.correct(fit.theta, whole.reading, whole.context)[:, 0]
    assert np.abs(corrected - printed[:, :3]).max() <= 0.005
    assert any("leaves open" in reason for reason in run.outcome.reasons)


@pytest.mark.parametrize("name", ["ab", "ai", "bi", "fb", "jd"])
def test_cave_instruments_at_rest(name: str) -> None:
    """No correction is worse than none on shots that took no part in any choice."""
    files = LabFiles(SAMPLES / f"cave_{name}.csv")
    run = calibrate_files(files, LabRequest(reference="norm"), lambda text: None)
    error = run.outcome.error.held_out
    assert run.result.loop is not None
    assert not any(step.certain for step in run.result.loop.steps)
    assert error.final <= error.base < 0.1 * error.raw
