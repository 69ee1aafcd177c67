"""What would do as well as a name: a curve of another driver among it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.calibrators.lab.position_table import read_position_table
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import run_lab
from imucalib.core.context import Context
from imucalib.effects import known
from imucalib.effects.shape import in_words
from imucalib.loop.evidence import Candidate, Score
from imucalib.loop.found import Step
from imucalib.loop.rivals.aliases import UNLISTED, _curve_beside, beside
from imucalib.loop.rivals.swings import keeps_step


def _score(name: str, kind: str, nats: float, curve: str = "") -> Score:
    candidate = Candidate(name, kind, np.zeros((1, 1)), curve=curve)  # type: ignore[arg-type]
    return Score(candidate, nats, 0.003, 299, 1.0, 5.0, 0.5)


@pytest.mark.parametrize(
    ("name", "curve", "lead", "rival"),
    [
        ("temperature_bias", "bias:tool_face:0:6", 2.9, True),
        ("temperature_bias", "bias:tool_face:0:6", 3.1, False),
        ("temperature_bias", "bias:temperature:20:30", 0.1, False),
        ("thermal_lag@2rows", "bias:temperature:20:30", 0.1, False),
        ("bias_step@record10", "bias:order:0:1", 0.1, False),
        ("quadratic", "response:x:-1:1", 0.1, False),
        ("quadratic", "bias:order:0:1", 0.1, True),
        ("inclination_zero", "inclination:inclination:-1:1", 0.1, False),
        ("inclination_zero", "bias:temperature:20:30", 0.1, True),
    ],
)
def test_a_curve_of_another_driver_with_as_much_evidence_is_a_rival(
    name: str, curve: str, lead: float, rival: bool
) -> None:
    effect = known(name)
    assert effect is not None
    own, other = _score(name, "effect", 20.0), _score("probe", "probe", 20.0 - lead, curve)
    found = _curve_beside(effect, own, (own, other))
    assert found == ((f"curve@{curve}:6",) if rival else ())
    assert all(known(one) is not None for one in found)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("curve@bias:tool_face:0:5.235987756:6", "a curve of the bias against tool face"),
        ("shape@response:xyz:soft_saturation:0.3", "a soft saturation of the response"),
        ("follows@scale:supply_V:12:0.5", "scale follows supply_V"),
        ("converter@xyz", "converter@xyz"),
        ("squares_across", "squares across"),
    ],
)
def test_names_for_a_reader(name: str, words: str) -> None:
    assert in_words(name) == words


def _creeping(path: Path, seed: int) -> Path:
    """Six rings of six; after each new inclination the bias settles, which no effect says."""
    rng = np.random.default_rng(seed)
    ring, place = np.repeat(np.arange(6), 6), np.tile(np.arange(6), 6)
    inclination, tool_face = 15.0 * ring, 60.0 * place
    i = np.deg2rad(inclination + 0.05 * rng.standard_normal(6)[ring])
    t = np.deg2rad(tool_face + 0.05 * rng.standard_normal(36))
    warm = 22.0 + 10.0 * (1.0 - np.exp(-np.arange(36) / 16.0)) + 0.2 * rng.standard_normal(36)
    force = np.stack([np.cos(i) * np.sin(t), np.cos(i) * np.cos(t), np.sin(i)], axis=1)
    along = rng.standard_normal(3)
    settling = 6.0 * np.exp(-place / 1.5)[:, None] * along / np.linalg.norm(along)
    reading = 1000.0 * force * [1.004, 0.997, 1.002] + [12.0, -7.0, 3.0] + settling
    reading += 0.6 * rng.standard_normal((36, 3))
    heading = "inclination,tool_face,temperature_C,x_mg,y_mg,z_mg"
    rows = np.column_stack([inclination, tool_face, warm, reading])
    np.savetxt(path, rows, "%.6g", ",", header=heading, comments="")
    return path


@pytest.mark.parametrize("seed", [1, 3])
def test_what_settles_after_each_setting_is_nothing_certain(tmp_path: Path, seed: int) -> None:
    sheet = _creeping(tmp_path / "sheet.csv", seed)
    loop = run_lab(read_position_table(sheet), LabRequest()).result.loop
    assert loop is not None
    step = loop.steps[0]
    assert step.effect.startswith("thermal_lag")
    assert not any(s.certain for s in loop.steps)  # what is left of it may look like anything
    assert UNLISTED in step.aliases  # 3 mg/°C: no data sheet has it


@pytest.mark.parametrize(("period", "same"), [(8.0, True), (8.0 / 3.0, True), (7.3, False)])
def test_a_swing_in_step_with_the_tool_face_may_be_the_tool_face(period: float, same: bool) -> None:
    """Rings of eight: a swing of eight rows is one turn of the tool-face, of 8/3 its third part."""
    turns = np.deg2rad(np.tile(np.arange(0.0, 360.0, 45.0), 7))
    context = Context(56, {"record": np.arange(56.0), "tool_face": turns})
    swing = known(f"cycle@{period:.6g}rows")
    assert swing is not None
    assert keeps_step(context, swing) is same


@pytest.mark.parametrize(
    ("rows", "same"), [("8", True), ("7.2", True), ("6", False), ("13", False)]
)
def test_a_swing_at_nearly_the_pace_of_the_tool_face_may_be_its_own(rows: str, same: bool) -> None:
    """A sag with the tool-face that grew with the inclination was a certain swing of the scale: of
    40 rows with eight a turn, five turns; 5.6 are near them, 6.7 are not."""
    dials = {"record": np.arange(40.0), "tool_face": np.tile(np.arange(8) * np.pi / 4.0, 5)}
    swing = known(f"scale_cycle@{rows}rows")
    assert swing is not None
    assert keeps_step(Context(40, dials), swing) is same


def test_a_swing_in_step_with_the_temperature_may_be_the_temperature() -> None:
    """Its change runs a quarter of a swing ahead of it."""
    rng = np.random.default_rng(3)
    dials = {"record": np.arange(40.0), "tool_face": rng.uniform(0.0, 6.2, 40)}
    warm = 25.0 + 5.0 * np.sin(2.0 * np.pi * np.arange(40.0) / 24.0)
    swing, other = known("cycle@24rows"), known("cycle@9rows")
    assert swing is not None
    assert other is not None
    assert keeps_step(Context(40, dials | {"temperature": warm}), swing)
    assert not keeps_step(Context(40, dials | {"temperature": warm}), other)
    assert not keeps_step(Context(40, dials), swing)


@pytest.mark.parametrize(("other", "together"), [("6.511", True), ("5.6", False), ("9", False)])
def test_swings_that_beat_are_one_that_comes_and_goes(other: str, together: bool) -> None:
    """A swing that began after a third of 56 rows was two, both for certain."""
    fit = SimpleNamespace(
        observations=SimpleNamespace(context=Context(56, {"record": np.arange(56.0)}))
    )
    first = Step("cycle@7rows", 0.003, 299, 9.0, (), ())
    chosen = _score(f"cycle@{other}rows", "effect", 9.0)
    (found,) = beside(fit, (first,), chosen)  # type: ignore[arg-type]
    assert (UNLISTED in found.aliases) is together


def test_long_periods_of_a_clock_are_read_whole() -> None:
    """1.2e+04 s beside 1.25e+04 s over five hours; read as 1.2 and 1.25 they were two."""
    fit = SimpleNamespace(
        observations=SimpleNamespace(context=Context(60, {"time": 300.0 * np.arange(60.0)}))
    )
    first = Step("cycle@1.2e+04s", 0.003, 299, 9.0, (), ())
    (found,) = beside(fit, (first,), _score("cycle@1.25e+04s", "effect", 9.0))  # type: ignore[arg-type]
    assert UNLISTED in found.aliases
