"""Coefficients of one accelerometer for other programs: what they keep, what they say of what they
lose, and how much that may be."""

from __future__ import annotations

import csv
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.core.effect import Context
from imucalib.core.fit import StoredParameter
from imucalib.core.sphere import count_by_cell, even_directions
from imucalib.effects import named
from imucalib.errors import LimitBroken, UsageError
from imucalib.exports import demand_carried, export
from imucalib.exports.flight import state_ids
from imucalib.exports.imus import NOISE_UNITS
from imucalib.exports.nearest import nearest_row
from worlds.stated import stated
from worlds.targets import by_ggir, by_imu_calib, by_qgroundcontrol, by_realsense

G = 9.80665
SPAN = (15.0, 35.0)
VALUES = {
    "mounting": (0.6, -0.5, -2.0),
    "bias": (20.0, -15.0, 30.0),
    "scale": (0.01, -0.02, 0.005),
    "non_orthogonality": (0.002, -0.001, 0.003),
    "temperature_bias": (0.8, -0.5, 1.2),
    "quadratic": (8.0, -6.0, 8.0),
}
SIX = ("bias", "scale")


def made(*effects: str, **facts: Any) -> Calibration:
    values = {name: VALUES[name] for name in effects}
    units = {"raw_unit": "ug", "raw_to_si": 1e-6 * G}
    return stated(values, valid={"temperature": SPAN}, facts=facts, **units)


def even(count: int = 3000) -> Array:
    """(n, 3) forces of 1 g, m/s²."""
    drawn = np.random.default_rng(1).normal(size=(count, 3))
    return np.asarray(G * drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


def warmth(count: int = 3000) -> Array:
    return np.random.default_rng(2).uniform(*SPAN, size=(count, 1))


def read_by(force: Array, *more: str, warm: Array | float = 25.0) -> Array:
    """What the sensor reads of forces in its own axes, m/s²."""
    reading = force * (1.0 + np.array(VALUES["scale"])) + 1e-3 * G * np.array(VALUES["bias"])
    if "non_orthogonality" in more:
        yx, zx, zy = VALUES["non_orthogonality"]
        reading[:, 1] += yx * force[:, 0]
        reading[:, 2] += zx * force[:, 0] + zy * force[:, 1]
    if "quadratic" in more:
        reading += 1e-3 * np.array(VALUES["quadratic"]) * force**2 / G
    return np.asarray(reading + 1e-3 * G * np.array(VALUES["temperature_bias"]) * (warm - 25.0))


def ground_station(text: str) -> dict[str, float]:
    """PX4's form has tabs, ArduPilot's names and values."""
    lines = [x for x in text.splitlines() if not x.startswith("#")]
    if "\t" in lines[0]:
        return by_qgroundcontrol(text)
    return {name: float(value) for name, value in (x.replace(",", " ").split() for x in lines)}


def thermal(form: str, known: dict[str, float], sensor: str, warm: Array) -> Array:
    """What a controller takes off at temperatures (n,) before its offsets, by its own arithmetic:
    PX4's calc_thermal_offsets_3D, ArduPilot's correct_sensor."""
    if form == "px4":
        name = f"TC_{sensor}0"
        if f"{name}_TREF" not in known:
            return np.zeros((warm.size, 3))
        assert known[f"TC_{sensor}_ENABLE"] == 1
        held = np.clip(warm, known[f"{name}_TMIN"], known[f"{name}_TMAX"])
        x = np.array([[known[f"{name}_X{k}_{axis}"] for axis in range(3)] for k in range(4)])
        by = (held - known[f"{name}_TREF"])[:, None]
        return np.asarray(x[0] + x[1] * by + x[2] * by**2 + x[3] * by**3)
    if not known.get("INS_TCAL1_ENABLE"):
        return np.zeros((warm.size, 3))
    name, at = {"A": ("ACC", "INS_ACC1_CALTEMP"), "G": ("GYR", "INS_GYR1_CALTEMP")}[sensor]
    c = np.array([[known[f"INS_TCAL1_{name}{k}_{a}"] for a in "XYZ"] for k in (1, 2, 3)])

    def taken(temperature: Array) -> Array:
        by = np.clip(temperature, known["INS_TCAL1_TMIN"], known["INS_TCAL1_TMAX"])[:, None] - 35.0
        return np.asarray((c[0] + (c[1] + c[2] * by) * by) * by * 1e-6)

    return taken(warm) - taken(np.array([known[at]]))


def flown(form: str, calibration: Calibration, raw: Array, warm: Array | None = None) -> Array:
    known = ground_station(export(calibration, "x.csv", form).text)
    if warm is not None:
        raw = raw - thermal(form, known, "A", warm.ravel())
    offset, scale = (
        ("CAL_ACC0_{}OFF", "CAL_ACC0_{}SCALE") if form == "px4" else
        ("INS_ACCOFFS_{}", "INS_ACCSCAL_{}")
    )  # fmt: skip
    off, by = (np.array([known[name.format(a)] for a in "XYZ"]) for name in (offset, scale))
    return np.asarray((raw - off) * by)


@pytest.mark.parametrize("form", ["px4", "ardupilot"])
def test_what_is_lost_in_flight_is_what_is_said(form: str) -> None:
    """Six numbers carry bias and scale; of more, the nearest."""
    assert flown(form, made(*SIX), read_by(even())) == pytest.approx(even(), abs=1e-6)
    assert len(ground_station(export(made(*SIX), "x.csv", form).text)) == 6
    effects = (*SIX, "non_orthogonality", "temperature_bias")
    whole = export(made(*effects), "x.csv", form)
    warm = np.repeat([*SPAN, 25.0], 1000)[:, None]
    got = flown(form, made(*effects), read_by(even(), *effects, warm=warm), warm)
    norm = np.abs(np.linalg.norm(got, axis=1) / G - 1.0) * 1e3
    # The turn that brings the vectors nearest, by the singular vectors of their products.
    left, _, right = np.linalg.svd(even().T @ got)
    due = even() @ (left @ right)
    cosine = np.einsum("ni,ni->n", got, due) / np.linalg.norm(got, axis=1) / G
    said = whole.lost[0]
    mean, worst, angle = (float(v) for v in re.findall(r"(\d+\.\d+) (?:mg|deg)", said))
    assert said.startswith("non orthogonality:")
    assert f"# Not in it: {said}." in whole.text
    assert mean == pytest.approx(norm.mean(), rel=0.03)
    assert worst == pytest.approx(norm.max(), rel=0.05)
    assert angle == pytest.approx(np.degrees(np.arccos(cosine.min())), rel=0.05)
    assert whole.loss == pytest.approx(1e3 * np.linalg.norm(got - due, axis=1).mean() / G, rel=0.03)


COLD_TO_HOT = (0.0, 60.0)
CURVE = "curve@bias:temperature:0:60:3"


@pytest.mark.parametrize("form", ["px4", "ardupilot"])
def test_a_bias_over_temperature_is_what_the_firmware_takes_off(form: str) -> None:
    effects = (*SIX, "temperature_bias")
    calibration = replace(made(*effects), valid={"temperature": COLD_TO_HOT})
    warm = np.linspace(*COLD_TO_HOT, 3000)
    reading = read_by(even(), warm=warm[:, None])
    assert flown(form, calibration, reading, warm) == pytest.approx(even(), abs=1e-6)


@pytest.mark.parametrize("form", ["px4", "ardupilot"])
def test_a_curve_over_temperature_becomes_the_nearest_cubic(form: str) -> None:
    terms = len(named(CURVE).parameters(Context(1)))
    values = {**{name: VALUES[name] for name in SIX}, CURVE: tuple(np.linspace(-3.0, 4.0, terms))}
    known = {"raw_unit": "m/s²", "raw_to_si": 1.0, "valid": {"temperature": COLD_TO_HOT}}
    calibration = stated(values, **known)
    warm = np.linspace(*COLD_TO_HOT, 200)
    model, theta = calibration.model()
    context = Context(warm.size, {"temperature": warm})
    read = model.predict(theta, np.zeros((warm.size, 1, 3)), context).reading[:, 0]
    station = ground_station(export(calibration, "x.csv", form).text)
    left = read - thermal(form, station, "A", warm)
    best = read - np.vander(warm, 4) @ np.polyfit(warm, read, 3)
    assert np.std(left, axis=0) == pytest.approx(np.std(best, axis=0), rel=0.06)
    assert np.all(np.std(left, axis=0) < 0.6 * np.std(read, axis=0))


UNITS = {"gyro_gain": "1", "gyro_temperature_bias": "deg/s/degC", "gyro_rest_bias": "deg/s"}


def with_gyroscope(whole: Calibration, **own: ArrayLike) -> Calibration:
    """With parameters of its effects by name, axis by axis or a matrix row by row."""
    names = {3: list("xyz"), 9: [f"{a}{b}" for a in "xyz" for b in "xyz"]}
    more = tuple(
        StoredParameter(f"{name}_{axis}", name, "gyroscope", float(value), 0.0, UNITS[name])
        for name, values in own.items()
        for axis, value in zip(names[np.size(values)], np.ravel(values), strict=True)
    )
    return replace(whole, parameters=(*whole.parameters, *more))


@pytest.mark.parametrize("form", ["px4", "ardupilot"])
def test_a_rate_over_temperature_is_what_the_firmware_takes_off(form: str) -> None:
    bias, slope = (0.4, -0.3, 0.2), (0.02, -0.01, 0.03)
    whole = replace(made(*SIX), valid={"temperature": COLD_TO_HOT})
    calibration = with_gyroscope(
        whole, gyro_gain=np.eye(3).ravel(), gyro_temperature_bias=slope, gyro_rest_bias=bias
    )
    warm = np.linspace(*COLD_TO_HOT, 40)
    known = ground_station(export(calibration, "x.csv", form).text)
    name = "CAL_GYRO0_{}OFF" if form == "px4" else "INS_GYROFFS_{}"
    offset = np.array([known[name.format(a)] for a in "XYZ"])
    read = np.radians(np.array(bias) + np.array(slope) * (warm[:, None] - 25.0))
    assert thermal(form, known, "G", warm) + offset == pytest.approx(read, abs=2e-9)


def test_a_realsense_camera_corrects_both_sensors() -> None:
    """500 readings of each through X, as the camera's tool applies it."""
    gain = np.eye(3) + 0.02 * np.random.default_rng(3).normal(size=(3, 3))
    bias = (0.4, -0.3, 0.2)
    whole = with_gyroscope(
        made(*SIX, "non_orthogonality"), gyro_gain=gain.ravel(), gyro_rest_bias=bias
    )
    known = by_realsense(export(whole, "x.csv", "realsense").text)
    force, rate = even(500), np.random.default_rng(4).normal(size=(500, 3))
    readings = {
        "accelerometer": read_by(force, "non_orthogonality"),
        "gyroscope": rate @ np.linalg.inv(gain).T + np.radians(bias),
    }
    ends = {name: np.column_stack([own, -np.ones(500)]) for name, own in readings.items()}
    assert ends["accelerometer"] @ known["accelerometer"] == pytest.approx(force, abs=1e-9)
    assert ends["gyroscope"] @ known["gyroscope"] == pytest.approx(rate, abs=1e-9)
    alone = by_realsense(export(made(*SIX), "x.csv", "realsense").text)
    assert np.array_equal(alone["gyroscope"], np.eye(4, 3))


def test_imu_calib_corrects_the_force() -> None:
    """500 readings through SM and bias, as its node applies them."""
    square, bias = by_imu_calib(export(made(*SIX, "non_orthogonality"), "x.csv", "imu-calib").text)
    raw = read_by(even(500), "non_orthogonality")
    assert raw @ square.T - bias == pytest.approx(even(500), abs=1e-9)


KNOWN = {"update_rate": 100.0, **dict.fromkeys(NOISE_UNITS, 1e-3)}


@pytest.mark.parametrize(
    "form", ["kalibr", "openvins", "c-header", "px4", "ardupilot", "realsense", "matlab"]
)
def test_a_delay_of_the_gyroscope_is_told(form: str) -> None:
    """Of several sds by every form of an IMU, within one by none."""

    def told(sd: float) -> str:
        imu = {"gyroscope_late_s": {"value": 7.5e-3, "sd": sd}}
        whole = with_gyroscope(
            made(*SIX, imu=imu), gyro_gain=np.eye(3).ravel(), gyro_rest_bias=np.zeros(3)
        )
        known = replace(whole, facts={**whole.facts, "noise_density": {"imu0": KNOWN}})
        return export(known, "x.csv", form).text

    held = "gyro_delay = 0.0075" if form == "matlab" else "7.500 ms"
    assert held in told(1e-3)
    assert held not in told(7e-3)


OMCONVERT = f"""#!{sys.executable}
import re, sys
at = sys.argv.index("-calibration")
assert sys.argv[sys.argv.index("-calibrate") + 1] == "0"
print(sys.argv[1], *filter(None, re.split("[ ,;]+", sys.argv[at + 1])))
"""


def test_omconvert_corrects_with_the_temperature(tmp_path: Path) -> None:
    (tmp_path / "omconvert").write_text(OMCONVERT)
    (tmp_path / "omconvert").chmod(0o755)
    whole = export(made(*SIX, "temperature_bias"), "x.csv", "omconvert")
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


def test_a_row_of_ggir_carries_the_temperature_and_what_was_seen() -> None:
    error = {"unit": "mg", "raw": 40.0, "held_out": {"raw": None, "final": 1.5}}
    whole = export(made(*SIX, "temperature_bias", errors=[error]), "x.csv", "ggir-csv")
    row, raw = by_ggir(whole.text, "x.csv"), read_by(even(), warm=warmth()) / G
    moved = raw + row["offset"] + row["temperature.offset"] * (warmth() - row["meantempcal"])
    assert np.abs(np.linalg.norm(row["scale"] * moved, axis=1) - 1.0).mean() < 1e-6
    assert (row["cal.error.start"], row["cal.error.end"]) == pytest.approx((0.04, 0.0015))
    assert row["use.temperature"]
    assert whole.lost == ()
    assert "imucal" in row["QCmessage"]
    assert np.isnan(row["n.10sec.windows"])
    known = made(*SIX, coverage={"still_windows": 3437, "hours": 23.5})
    row = by_ggir(export(known, "x.csv", "ggir-csv").text, "x.csv")
    assert (row["n.10sec.windows"], row["n.hours.considered"]) == (3437, 23.5)
    assert not row["use.temperature"]


def c_numbers(text: str, name: str) -> Array:
    body = re.search(rf"{name}[^=]*= ([^;]*);", text)
    assert body
    return np.array([float(v) for v in re.findall(r"-?\d+\.\d+e[+-]\d+", body[1])])


@pytest.mark.parametrize("more", ["temperature_bias", "quadratic"])
def test_a_c_header_says_in_mg_what_it_lacks(more: str) -> None:
    whole = export(made(*SIX, more), "x.csv", "c-header")
    warm = warmth() if more == "temperature_bias" else 25.0
    reading, force = read_by(even(), more, warm=warm) / G, even() / G
    M, b = c_numbers(whole.text, "imucal_M").reshape(3, 3), c_numbers(whole.text, "imucal_b")
    off = np.linalg.norm(reading @ M.T + b - force, axis=1) * 1e3
    (said,) = whole.lost
    assert more.replace("_", " ") in said
    assert said in whole.text
    mean, worst = (float(v) for v in re.findall(r"(\d+\.\d+) mg", said))
    # The stated figures are at the ends and the middle of the range, the world is even in it.
    assert 0.6 * mean < off.mean() < 1.2 * mean
    assert off.max() < 1.1 * worst
    # No other linear correction does much better here.
    columns = np.column_stack([reading, np.ones(len(reading))])
    best = columns @ np.linalg.lstsq(columns, force, rcond=None)[0]
    assert off.mean() < 1.02 * np.linalg.norm(best - force, axis=1).mean() * 1e3


@pytest.mark.parametrize(("form", "name"), [("px4", "CAL_ACC0_ID"), ("ardupilot", "INS_ACC_ID")])
def test_the_sensors_id_is_written_or_asked_for(form: str, name: str) -> None:
    """A controller passes over parameters of another id."""
    plain = export(made(*SIX), "x.csv", form)
    assert name not in ground_station(plain.text)
    assert any(f"{name}: " in lost and "--device-id" in lost for lost in plain.lost)
    known = export(state_ids(made(*SIX), (1310988, 7)), "x.csv", form)
    assert ground_station(known.text)[name] == 1310988
    assert len(ground_station(known.text)) == 7  # there is no gyroscope that 7 would be of
    assert known.lost == ()


def error_model(calibration: Calibration) -> list[dict[str, str]]:
    text = export(calibration, "x.csv", "iscwsa-csv").text
    return list(csv.DictReader(x for x in text.splitlines() if not x.startswith("#")))


def test_the_error_models_rows_say_what_the_tool_reads() -> None:
    found = [r for r in error_model(made(*SIX, "non_orthogonality")) if not r["code"]]
    S, c = np.eye(3), np.zeros(3)
    for r in found:
        k = "xyz".index(r["axis"])
        if r["term"] == "bias":
            assert r["unit"] == "m/s2"
            c[k] = float(r["value"])
        else:
            S[k, "xyz".index(r["towards"] or r["axis"])] += float(r["value"])
    assert len(found) == 12
    assert even() @ S.T + c == pytest.approx(read_by(even(), "non_orthogonality"), abs=1e-7)


def test_what_a_controller_does_not_take_is_refused() -> None:
    def with_first(name: str, value: float) -> Calibration:
        whole = made(*SIX)
        moved = (replace(p, value=value) if p.name == name else p for p in whole.parameters)
        return replace(whole, parameters=tuple(moved))

    with pytest.raises(UsageError, match=r"scales of 0\.8 to 1\.2.*unit"):
        export(with_first("scale_x", 0.5), "x", "ardupilot")
    with pytest.raises(UsageError, match=r"offsets up to 3\.5"):
        export(with_first("bias_x", 900.0), "x", "ardupilot")
    assert "CAL_ACC0_XOFF\t8.8" in export(with_first("bias_x", 900.0), "x", "px4").text


def test_a_row_is_right_where_postures_were_recorded() -> None:
    """A sensor whose cross terms six numbers cannot carry, worn in one octant only: the row is
    better there than one that is fitted to all directions, and worse elsewhere."""
    up = even_directions(400)
    up = up[np.all(up > 0.0, axis=1)]
    same, worn = (
        made(*SIX, "non_orthogonality", **facts) for facts in ({}, {"postures": count_by_cell(up)})
    )
    rows = [nearest_row(one) for one in (same, worn)]
    raw = read_by(G * up, "non_orthogonality") / G
    off = [np.abs(np.linalg.norm(r.scale * (raw + r.offset), axis=1) - 1.0).mean() for r in rows]
    assert off[1] < 0.5 * off[0]
    assert rows[1].lost < rows[0].lost
    assert rows[1].worst > rows[0].worst


@pytest.mark.parametrize("form", ["px4", "ardupilot", "omconvert", "ggir-csv", "c-header",
                                  "matlab", "iscwsa-csv", "realsense", "imu-calib"])  # fmt: skip
def test_a_form_is_refused_that_is_no_better_than_the_raw_reading(form: str) -> None:
    def worth(raw: float, left: float = 0.1) -> Calibration:
        """A sensor with a square, and the errors before and after its calibration, mg."""
        error = {"unit": "mg", "raw": raw, "final": left, "held_out": {"raw": raw, "final": left}}
        return made(*SIX, "quadratic", errors=[error])

    whole = export(worth(40.0), "x.csv", form)
    loss = whole.loss
    assert not any("_" in text.partition(":")[0] for text in whole.lost if "quadratic" in text)
    assert 0.5 < loss < 20.0
    demand_carried(whole, form, worth(1.1 * loss), None)
    with pytest.raises(LimitBroken, match=r"quadratic.*--force.*--largest-loss") as refused:
        demand_carried(whole, form, worth(0.9 * loss), None)
    assert refused.value.exit_code == 1
    assert f"{loss:.3g} mg" in str(refused.value)
    # The bound that the message names passes.
    named_bound = float(str(refused.value).split("--largest-loss ")[1].split("`")[0])
    demand_carried(whole, form, worth(0.0), named_bound)
    with pytest.raises(LimitBroken):
        demand_carried(whole, form, worth(100.0), 0.9 * loss)
