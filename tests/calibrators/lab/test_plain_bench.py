"""Two writings of the printed equations agree: a sheet without noise from the plain-numpy world
is fitted to nothing by the calibrator that is told what was planted."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

from imucalib.calibrators.lab.calibrate import LabSettings
from imucalib.calibrators.lab.position_table import read_position_table
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import run_lab
from imucalib.effects import catalogue, named
from worlds import plain_bench, plain_defects

OUTSIDE = {
    "third_harmonic", "slip", "local_sine", "thermal_lag", "thermal_play", "thermal_creep",
    "mixed_third", "random_walk", "shock", "late_reading", "pick_up", "soft_saturation", "swing",
    "supply", "scale_walk",
}  # fmt: skip
EVERY = [*plain_defects.DIALS, *plain_defects.AXES, *plain_defects.SENSOR]
PLANTED = [name for name in EVERY if name not in OUTSIDE]
FORMS = [
    "bias:order:exponential:0.2:0", "bias:temperature:kink:26", "response:xyz:saturation:0.6",
    "response:y:power:5:0:1", "response:xyz:saw_tooth:0.3:0.2",
]  # fmt: skip


@pytest.mark.parametrize("module", [plain_bench, plain_defects])
def test_the_world_knows_nothing_of_the_code(module: object) -> None:
    tree = ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8"))  # type: ignore[attr-defined]
    found = {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
    found |= {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
    allowed = {"__future__", "dataclasses", "pathlib", "collections.abc", "numpy", "numpy.typing"}
    assert found <= allowed | {"worlds.plain_defects"}


def test_every_effect_that_a_sheet_can_show_is_planted() -> None:
    known = {e.name for e in catalogue().values() if e.stage in ("fixture", "sensor")}
    assert set(PLANTED) <= known | {*plain_defects.SCANNED}
    assert len(PLANTED) == 31


@pytest.mark.slow
@pytest.mark.parametrize("name", [*PLANTED, *FORMS])
def test_a_planted_effect_is_fitted_to_nothing(name: str, tmp_path: Path) -> None:
    plan = plain_bench.Plan(7, ((name, 10.0),), sigma=1e-7, scatter=1e-7, n=40)
    bench = plain_bench.Bench(plan)
    # λ is in units of the noise: bring it to that of a usual bench.
    bench.size = {name: 1e6 * p for name, p in bench.size.items()}
    bench.reading = bench.noted(bench.conditions, np.random.default_rng(0))
    told = f"shape@{name}" if ":" in name else name
    told = plain_defects.member(name, bench.conditions.at) or told
    settings = LabSettings(loop=False, declare=(told,))
    request = LabRequest(unit="mg", settings=settings)
    result = run_lab(read_position_table(bench.write(tmp_path / "sheet.csv")), request).result
    fit = result.final
    assert result.error.final < 0.05
    at = fit.model.slices(fit.observations.context)
    assert fit.theta[at["bias"]] == pytest.approx(bench.bias, abs=2e-2)
    assert fit.theta[at["scale"]] == pytest.approx(bench.scale, abs=2e-5)
    assert fit.theta[at["non_orthogonality"]] == pytest.approx(bench.cross, abs=2e-5)
    assert fit.theta[at["mounting"]] == pytest.approx(bench.mounting, abs=2e-3)
    if named(told).stage != "fixture" and ":" not in name:
        assert fit.theta[at[told]] == pytest.approx(bench.size[name], rel=2e-3, abs=2e-3)
    elif ":" not in name:
        assert np.abs(fit.theta[at[told]]) == pytest.approx(np.abs(bench.size[name]), rel=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    "pair",
    [("temperature_scale", "cubic"), ("base_tilt_across", "hysteresis")],
    ids=" and ".join,
)
def test_two_effects_are_proved_by_what_took_no_part(pair: tuple[str, str], tmp_path: Path) -> None:
    """Without a position one effect was held against the noise of both, and none was taken."""
    bench = plain_bench.Bench(plain_bench.Plan(3, tuple((name, 20.0) for name in pair), n=32))
    table = read_position_table(bench.write(tmp_path / "sheet.csv"))
    run = run_lab(table, LabRequest(unit="mg"))
    assert run.result.loop is not None
    # A form of the response may stand for the cube: it has no cause, so nothing is named wrongly.
    steps = {s.effect.partition(":")[0] for s in run.result.loop.steps}
    assert {"cubic" if s == "shape@response" else s for s in steps} == set(pair)
    assert run.result.loop.verdict == "explained"
    held = run.outcome.errors[0].held_out
    assert held.final < 0.7 * held.base


@pytest.mark.slow
def test_noise_that_lasts_is_noise_on_a_long_sheet_too(tmp_path: Path) -> None:
    """Beyond 110 rows it was not looked for: steps and swings stood for it."""
    bench = plain_bench.Bench(plain_bench.Plan(4, (), noise="ar", n=130))
    run = run_lab(read_position_table(bench.write(tmp_path / "sheet.csv")), LabRequest(unit="mg"))
    assert run.result.loop is not None
    assert not run.result.loop.steps
    assert run.result.final.observations.walk is not None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "size", "rows", "seed", "due"),
    [
        ("product_across", 20.0, 48, 3, "product_across"),
        ("squares_across", 20.0, 48, 3, "squares_across"),
        ("scale_drift", 50.0, 24, 3, "scale_drift"),
        ("thermal_lag", 12.0, 36, 3, "thermal_lag@4rows"),
        ("thermal_play", 15.0, 48, 3, "thermal_hysteresis@6C"),
        ("temperature_misalignment", 15.0, 40, 0, "temperature_misalignment"),
        ("mixed_third", 18.0, 40, 2, "third_degree@z"),
        ("swing", 15.0, 36, 0, "cycle@7.3rows"),
        ("supply", 15.0, 36, 0, "scale_cycle@13.3rows"),
        ("slip", 15.0, 36, 0, "slip@record19"),
    ],
)
def test_one_effect_is_named_and_corrected(
    name: str, size: float, rows: int, seed: int, due: str, tmp_path: Path
) -> None:
    bench = plain_bench.Bench(plain_bench.Plan(seed, ((name, size),), n=rows))
    run = run_lab(read_position_table(bench.write(tmp_path / "sheet.csv")), LabRequest(unit="mg"))
    assert run.result.loop is not None
    (step,) = run.result.loop.steps
    family, _, period = due.partition("@")
    if family.endswith("cycle"):
        found, _, at = step.effect.partition("@")
        assert found == family
        near = pytest.approx(float(period.removesuffix("rows")), rel=0.07)
        assert float(at.removesuffix("rows")) == near
    else:
        assert due in {called.partition(":")[0] for called in (step.effect, *step.aliases)}
    held = run.outcome.errors[0].held_out
    assert held.final < 0.8 * held.base
