"""Forms of a scale and an offset an axis, and what a form may lose."""

from __future__ import annotations

import csv
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.calibration.calibration import Calibration, StoredParameter
from imucalib.core.effect import Context
from imucalib.core.sphere import counted, even_directions
from imucalib.effects import named
from imucalib.errors import LimitBroken, UsageError
from imucalib.exports import exported
from imucalib.exports.bound import demand_carried
from imucalib.exports.imus import with_walks
from imucalib.exports.per_axis import nearest_row, with_ids
from worlds.rigid_board import board
from worlds.rigid_board import calibration as board_calibration
from worlds.targets import by_qgroundcontrol

Array = NDArray[np.float64]


G = 9.80665


SPAN = (15.0, 35.0)


VALUES = {
    "mounting": (0.6, -0.5, -2.0),
    "bias": (20.0, -15.0, 30.0),
    "scale": (0.01, -0.02, 0.005),
    "non_orthogonality": (0.002, -0.001, 0.003),
    "temperature_bias": (0.8, -0.5, 1.2),
}


SIX = ("bias", "scale")


def made(*effects: str) -> Calibration:
    parameters = tuple(
        StoredParameter(p.name, name, named(name).stage, value, 0.1, p.unit)
        for name in effects
        for p, value in zip(named(name).parameters(Context(1)), VALUES[name], strict=True)
    )
    return Calibration("lab", parameters, 0.01 * np.eye(len(parameters)), "ug", 1e-6 * G, G, "ok",
                       valid={"temperature": SPAN})  # fmt: skip


def even(count: int = 3000) -> Array:
    """(n, 3) forces of 1 g, m/s²."""
    drawn = np.random.default_rng(1).normal(size=(count, 3))
    return np.asarray(G * drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


def warmth(count: int = 3000) -> Array:
    return np.random.default_rng(2).uniform(*SPAN, size=(count, 1))


def read_by(force: Array, *, skew: bool = False, warm: Array | float = 25.0) -> Array:
    """What the sensor reads of forces in its own axes, m/s²."""
    x, y, z = VALUES["bias"]
    reading = force * (1.0 + np.array(VALUES["scale"])) + 1e-3 * G * np.array([x, y, z])
    if skew:
        yx, zx, zy = VALUES["non_orthogonality"]
        reading[:, 1] += yx * force[:, 0]
        reading[:, 2] += zx * force[:, 0] + zy * force[:, 1]
    return np.asarray(reading + 1e-3 * G * np.array(VALUES["temperature_bias"]) * (warm - 25.0))


def ground_station(text: str) -> dict[str, float]:
    """PX4's form has tabs, ArduPilot's names and values."""
    lines = [x for x in text.splitlines() if not x.startswith("#")]
    if "\t" in lines[0]:
        return by_qgroundcontrol(text)
    return {name: float(value) for name, value in (x.replace(",", " ").split() for x in lines)}


def flown(form: str, calibration: Calibration, raw: Array) -> Array:
    known = ground_station(exported(calibration, "x.csv", form).text)
    offset, scale = (
        ("CAL_ACC0_{}OFF", "CAL_ACC0_{}SCALE") if form == "px4" else
        ("INS_ACCOFFS_{}", "INS_ACCSCAL_{}")
    )  # fmt: skip
    assert len(known) == 6
    off, by = (np.array([known[name.format(a)] for a in "XYZ"]) for name in (offset, scale))
    return np.asarray((raw - off) * by)


@pytest.mark.parametrize("form", ["px4", "ardupilot"])
def test_a_flight_controller_corrects_what_six_numbers_can(form: str) -> None:
    assert flown(form, made(*SIX), read_by(even())) == pytest.approx(even(), abs=1e-6)


@pytest.mark.parametrize("form", ["px4", "ardupilot"])
def test_what_is_lost_in_flight_is_what_is_told(form: str) -> None:
    effects = (*SIX, "non_orthogonality", "temperature_bias")
    whole = exported(made(*effects), "x.csv", form)
    warm = np.repeat([*SPAN, 25.0], 1000)[:, None]
    got = flown(form, made(*effects), read_by(even(), skew=True, warm=warm))
    norm = np.abs(np.linalg.norm(got, axis=1) / G - 1.0) * 1e3
    # The turn that brings the vectors nearest, by the singular vectors of their products.
    left, _, right = np.linalg.svd(even().T @ got)
    due = even() @ (left @ right)
    cosine = np.einsum("ni,ni->n", got, due) / np.linalg.norm(got, axis=1) / G
    told = whole.lost[0]
    mean, worst, angle = (float(v) for v in re.findall(r"(\d+\.\d+) (?:mg|deg)", told))
    assert told.startswith("non_orthogonality, temperature_bias:")
    assert f"# Not in it: {told}." in whole.text
    assert mean == pytest.approx(norm.mean(), rel=0.03)
    assert worst == pytest.approx(norm.max(), rel=0.05)
    assert angle == pytest.approx(np.degrees(np.arccos(cosine.min())), rel=0.05)
    assert whole.loss == pytest.approx(1e3 * np.linalg.norm(got - due, axis=1).mean() / G, rel=0.03)


OMCONVERT = f"""#!{sys.executable}
import re, sys
at = sys.argv.index("-calibration")
assert sys.argv[sys.argv.index("-calibrate") + 1] == "0"
print(sys.argv[1], *filter(None, re.split("[ ,;]+", sys.argv[at + 1])))
"""


def test_omconvert_corrects_with_the_temperature(tmp_path: Path) -> None:
    (tmp_path / "omconvert").write_text(OMCONVERT)
    (tmp_path / "omconvert").chmod(0o755)
    whole = exported(made(*SIX, "temperature_bias"), "x.csv", "omconvert")
    assert whole.lost == ()
    (tmp_path / "given.sh").write_text(whole.text)
    done = subprocess.run(
        ["sh", "given.sh", "week.cwa", "-out", "week.wav"], cwd=tmp_path, check=True, text=True,
        capture_output=True, env={**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"},
    )  # fmt: skip
    recording, *numbers = done.stdout.split()
    assert recording == "week.cwa"
    v = np.array(numbers, dtype=float)
    assert v.shape == (10,)
    raw = read_by(even(), warm=warmth()) / G
    corrected = (raw + v[3:6]) * v[:3] + (warmth() - v[9]) * v[6:9]
    assert corrected == pytest.approx(even() / G, abs=1e-7)


@pytest.mark.parametrize(("form", "name"), [("px4", "CAL_ACC0_ID"), ("ardupilot", "INS_ACC_ID")])
def test_the_sensors_id_is_written_or_asked_for(form: str, name: str) -> None:
    """A controller passes over parameters of another id."""
    plain = exported(made(*SIX), "x.csv", form)
    assert name not in ground_station(plain.text)
    assert any(f"{name}: " in lost and "--device-id" in lost for lost in plain.lost)
    known = exported(with_ids(made(*SIX), (1310988, 7)), "x.csv", form)
    assert ground_station(known.text)[name] == 1310988
    assert len(ground_station(known.text)) == 7  # there is no gyroscope that 7 would be of
    assert known.lost == ()


def error_model(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(x for x in text.splitlines() if not x.startswith("#")))


def test_the_error_models_rows_say_what_the_tool_reads() -> None:
    rows = error_model(exported(made(*SIX, "non_orthogonality"), "x.csv", "iscwsa-csv").text)
    found = [r for r in rows if not r["code"]]
    S, c = np.eye(3), np.zeros(3)
    for r in found:
        k = "xyz".index(r["axis"])
        if r["term"] == "bias":
            assert r["unit"] == "m/s2"
            c[k] = float(r["value"])
        else:
            S[k, "xyz".index(r["towards"] or r["axis"])] += float(r["value"])
    assert len(found) == 12
    assert even() @ S.T + c == pytest.approx(read_by(even(), skew=True), abs=1e-7)


def test_a_tool_code_has_one_standard_deviation_of_what_is_left() -> None:
    """A bias of ABZ tilts a tool at 30° by the weighting function's -sin I / G."""
    calibration = made(*SIX)
    rows = {r["code"]: r for r in error_model(exported(calibration, "x", "iscwsa-csv").text)
            if r["code"]}  # fmt: skip
    abz = float(rows["ABZ"]["sd"])
    assert abz == pytest.approx(0.1e-3 * G, rel=1e-3)
    at = np.radians(30.0)
    tilted = np.arctan2(G * np.sin(at), G * np.cos(at) + abz) - at
    assert tilted == pytest.approx(-np.sin(at) / G * abz, rel=1e-3)
    assert {r["propagation"] for r in rows.values()} == {"systematic"}
    assert float(rows["ASXY-TI1S"]["sd"]) == pytest.approx(0.1, rel=0.05)
    assert float(rows["AXYZ-MIS"]["sd"]) == 0.0


def test_what_a_controller_does_not_take_is_refused() -> None:
    with pytest.raises(UsageError, match=r"scales of 0\.8 to 1\.2.*unit"):
        exported(scaled("scale", 0.5), "x", "ardupilot")
    with pytest.raises(UsageError, match=r"offsets up to 3\.5"):
        exported(scaled("bias", 900.0), "x", "ardupilot")
    assert "CAL_ACC0_XOFF\t8.8" in exported(scaled("bias", 900.0), "x", "px4").text


def scaled(effect: str, value: float) -> Calibration:
    whole = made(*SIX)
    first, *rest = (p for p in whole.parameters if p.effect == effect)
    others = (p for p in whole.parameters if p.effect != effect)
    order = [replace(first, value=value), *rest, *others]
    return replace(whole, parameters=tuple(sorted(order, key=lambda p: SIX.index(p.effect))))


def test_a_row_is_right_where_postures_were_recorded() -> None:
    """A sensor whose cross terms six numbers cannot carry, worn in one octant only: the row is
    better there than one that is fitted to all directions, and worse elsewhere."""
    alike = made("bias", "scale", "non_orthogonality")
    up = even_directions(400)
    up = up[np.all(up > 0.0, axis=1)]
    worn = replace(alike, facts={**alike.facts, "postures": counted(up).tolist()})
    rows = [nearest_row(one) for one in (alike, worn)]
    model, theta = alike.model()
    raw = model.predict(theta, G * up[:, None], Context(len(up))).reading[:, 0] / G
    off = [np.abs(np.linalg.norm(r.scale * (raw + r.offset), axis=1) - 1.0).mean() for r in rows]
    assert off[1] < 0.5 * off[0]
    assert rows[1].lost < rows[0].lost
    assert rows[1].worst > rows[0].worst


BOUND_VALUES = {
    "bias": (20.0, -15.0, 30.0),
    "scale": (0.01, -0.02, 0.005),
    "quadratic": (8.0, -6.0, 8.0),
}


def bent(left: float | None) -> Calibration:
    """A sensor with a square, and the error that its calibration leaves, mg."""
    parameters = tuple(
        StoredParameter(p.name, name, "sensor", value, 0.1, p.unit)
        for name, values in BOUND_VALUES.items()
        for p, value in zip(named(name).parameters(Context(1)), values, strict=True)
    )
    error = {"unit": "mg", "raw": 40.0, "final": left, "held_out": {"final": left}}
    return Calibration("lab", parameters, 0.01 * np.eye(len(parameters)), "ug", 9.8e-6, 9.80665,
                       "ok", facts={"errors": [error]})  # fmt: skip


@pytest.mark.parametrize("form", ["px4", "ardupilot", "omconvert", "ggir-csv", "c-header",
                                  "matlab", "iscwsa-csv"])  # fmt: skip
def test_a_form_is_refused_beyond_three_times_what_is_left(form: str) -> None:
    made = exported(bent(1.0), "x.csv", form)
    loss = made.loss
    assert 0.5 < loss < 20.0
    demand_carried(made, form, bent(loss / 2.9), None)
    with pytest.raises(LimitBroken, match=r"quadratic.*--force.*--largest-loss") as refused:
        demand_carried(made, form, bent(loss / 3.1), None)
    assert refused.value.exit_code == 1
    assert f"{loss:.3g} mg" in str(refused.value)
    # The bound that the message names passes.
    named_bound = float(str(refused.value).split("--largest-loss ")[1].split("`")[0])
    demand_carried(made, form, bent(0.0), named_bound)
    with pytest.raises(LimitBroken):
        demand_carried(made, form, bent(100.0), 0.9 * loss)


@pytest.mark.parametrize("effect", ["gyro_cubic", "gyro_delay"])
def test_of_an_array_the_rates_of_motion_count(effect: str) -> None:
    whole = board_calibration(board(np.random.default_rng(0), chips=3))
    rate = {"unit": "deg/s", "final": 0.5, "held_out": {"final": 0.4}}
    facts = {"not_undone": [{"effect": effect, "rms": 9.0, "unit": "deg/s"}], "errors": [rate]}
    known = with_walks(replace(whole, facts={**whole.facts, "sample_interval_s": 0.01, **facts}),
                       1e-3, 2e-5)  # fmt: skip
    for form in ("c-header", "kalibr", "openvins"):
        made = exported(known, "x", form)
        assert (made.loss, made.rate_loss) == (0.0, 9.0)
        with pytest.raises(LimitBroken, match=r"9 deg/s, more than 1.2.*--largest-loss 0,9`"):
            demand_carried(made, form, known, None)
        demand_carried(made, form, known, 0.0, 9.0)
        with pytest.raises(LimitBroken):
            demand_carried(made, form, known, None, 8.9)
    # A frame loses no reading, and the script holds the delay.
    assert exported(known, "x", "urdf").rate_loss == 0.0
    held = exported(known, "x", "matlab").rate_loss
    assert held == (0.0 if effect == "gyro_delay" else 9.0)


def test_of_an_array_the_forces_of_motion_count() -> None:
    whole = board_calibration(board(np.random.default_rng(0), chips=3))
    facts = {"not_undone": [{"effect": "sensing_elements", "rms": 0.3, "unit": "m/s²"},
                            {"effect": "gyro_cubic", "rms": 9.0, "unit": "deg/s"}],
             "errors": [{"unit": "m/s²", "final": 0.05, "held_out": {"final": 0.05}}]}  # fmt: skip
    facts = {**whole.facts, "sample_interval_s": 0.01, **facts}
    known = with_walks(replace(whole, facts=facts), 1e-3, 2e-5)
    loss = {f: exported(known, "x", f).loss for f in ("kalibr", "urdf", "c-header", "matlab")}
    # Kalibr has a place for the elements, a frame none for any of it.
    assert loss["kalibr"] == loss["urdf"] == 0.0
    assert loss["c-header"] == loss["matlab"] == pytest.approx(0.3 / 9.80665e-3)
    with pytest.raises(LimitBroken, match="sensing_elements"):
        demand_carried(exported(known, "x", "c-header"), "c-header", known, None)
