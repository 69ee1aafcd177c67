"""What a flight controller had corrected before it logged is in the parameters that it gets: loaded
as they stand, its own formula gives the force, whichever parameters were in force before."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.file import from_dict, to_yaml
from imucalib.core.fit import StoredParameter
from imucalib.errors import UsageError
from imucalib.exports import export
from imucalib.readers import read
from imucalib.recording.identity import accelerometer_of, identity_of
from imucalib.recording.yaml_text import load
from worlds.command import run
from worlds.flight_logs import dataflash, ulog
from worlds.stated import stated
from worlds.targets import by_qgroundcontrol

COUNT, RATE = 3, 10
RNG = np.random.default_rng(5)
ATTITUDES = RNG.normal(size=(20, 3))
FORCE = np.repeat(9.80665 * ATTITUDES / np.linalg.norm(ATTITUDES, axis=1, keepdims=True), 20, 0)
TURN = RNG.normal(0.0, 0.5, (400, 3))
STAMPS = np.arange(400, dtype=np.int64) * (1_000_000 // RATE) + 1_000_000
#: Of each chip: raw = gain force + bias, rate = turn + drift; and what was in force for it.
GAIN, BIAS, DRIFT = (
    RNG.normal(mean, size, (COUNT, 3)) for mean, size in ((1.0, 0.02), (0.0, 0.3), (0.0, 0.02))
)
OFFSET, SCALE, STILL = (
    RNG.normal(mean, size, (COUNT, 3)) for mean, size in ((0.1, 0.2), (1.0, 0.01), (0.0, 0.01))
)
RAW, RATES = FORCE * GAIN[:, None] + BIAS[:, None], TURN + DRIFT[:, None]
#: PX4 keeps a chip in whichever slot has its id.
SLOTS = (2, 0, 1)


def after(raw: Array, offset: Array, scale: Array | float = 1.0) -> Array:
    """PX4's Accelerometer::Correct, ArduPilot's _rotate_and_correct_accel."""
    return np.asarray(
        (raw - offset[..., None, :]) * (scale if np.isscalar(scale) else scale[..., None, :])
    )


def triple(name: str, values: Array) -> dict[str, float]:
    return {name.format(a): float(v) for a, v in zip("XYZ", values, strict=True)}


def of_px4() -> dict[str, float]:
    found: dict[str, float] = {}
    for k, slot in enumerate(SLOTS):
        found |= {f"CAL_ACC{slot}_ID": 1001 + k, f"CAL_GYRO{slot}_ID": 2001 + k}
        found |= triple(f"CAL_ACC{slot}_{{}}OFF", OFFSET[k])
        found |= triple(f"CAL_ACC{slot}_{{}}SCALE", SCALE[k])
        found |= triple(f"CAL_GYRO{slot}_{{}}OFF", STILL[k])
    return found


def of_ardupilot() -> dict[str, float]:
    found: dict[str, float] = {}
    for k, n in enumerate(("", "2", "3")):
        found |= {f"INS_ACC{n}_ID": 1001 + k, f"INS_GYR{n}_ID": 2001 + k}
        found |= triple(f"INS_ACC{n}OFFS_{{}}", OFFSET[k])
        found |= triple(f"INS_ACC{n}SCAL_{{}}", SCALE[k])
        found |= triple(f"INS_GYR{n}OFFS_{{}}", STILL[k])
    return found


def px4_log(path: Path, parameters: Mapping[str, float]) -> Path:
    path.write_bytes(ulog(STAMPS, *floats(RAW, RATES), parameters=parameters))
    return path


def px4_fed(path: Path, parameters: Mapping[str, float]) -> Path:
    """As the filter is fed: corrected, and of the first chip alone."""
    only = {k: v for k, v in parameters.items() if "2_" in k or "ROT" in k}
    done = after(RAW, OFFSET, SCALE), after(RATES, STILL)
    path.write_bytes(ulog(STAMPS, *floats(*done), combined=True, parameters=only))
    return path


def px4_selected(path: Path, parameters: Mapping[str, float]) -> Path:
    """The same with the parameters of all, of the chip that the log says."""
    done = after(RAW, OFFSET, SCALE), after(RATES, STILL)
    path.write_bytes(
        ulog(STAMPS, *floats(*done), combined=True, parameters=parameters, selected=(1001, 2001))
    )
    return path


def ardupilot_log(path: Path, parameters: Mapping[str, float]) -> Path:
    done = after(RAW, OFFSET, SCALE), after(RATES, STILL)
    path.write_bytes(dataflash(STAMPS, *floats(*done), parameters=parameters.items()))
    return path


def floats(*values: Array) -> list[Any]:
    return [v.astype(np.float32) for v in values]


Log = Callable[[Path, Mapping[str, float]], Path]
LOGS: dict[str, tuple[str, Log, Callable[[], dict[str, float]], int]] = {
    "px4.ulg": ("px4", px4_log, of_px4, COUNT),
    "fed.ulg": ("px4", px4_fed, of_px4, 1),
    "selected.ulg": ("px4", px4_selected, of_px4, 1),
    "ardupilot.bin": ("ardupilot", ardupilot_log, of_ardupilot, COUNT),
}


def calibration_of(path: Path, sensor: str) -> Calibration:
    """The calibration of what the log holds of a sensor, by a fit of each axis to what was."""
    log = read(path)
    read_, rate = (log.channels[f"{sensor}/{q}"].values for q in ("acceleration", "angular_rate"))
    line = [np.polyfit(FORCE[:, k], read_[:, k], 1) for k in range(3)]
    bias, drift = [1e3 * c / 9.80665 for _, c in line], np.degrees((rate - TURN).mean(axis=0))
    values = {"bias": bias, "scale": [a - 1.0 for a, _ in line]}
    gyro = {"gyro_gain": ("1", np.eye(3).ravel()), "gyro_rest_bias": ("deg/s", drift)}
    more = tuple(
        StoredParameter(f"{effect}_{k}", effect, "gyroscope", float(value), 0.0, unit)
        for effect, (unit, numbers) in gyro.items()
        for k, value in enumerate(numbers)
    )
    made = stated(values, raw_unit="m/s²", raw_to_si=1.0)
    parameters, own = (*made.parameters, *more), identity_of(log, sensor)
    covariance = np.zeros((len(parameters),) * 2)
    return replace(made, parameters=parameters, covariance=covariance, sensor=own)


def loaded(form: str, text: str) -> dict[str, float]:
    if form == "px4":
        return by_qgroundcontrol(text)
    lines = (x.split(",") for x in text.splitlines() if not x.startswith("#"))
    return {name: float(value) for name, value in lines}


@pytest.mark.parametrize("name", LOGS)
def test_each_chip_is_corrected_by_its_own(name: str, tmp_path: Path) -> None:
    form, log, parameters, count = LOGS[name]
    path = log(tmp_path / name, parameters())
    for k in range(count):
        text = export(calibration_of(path, f"imu{k}"), name, form).text
        known = {**parameters(), **loaded(form, text)}
        assert "--device-id" not in text
        if form == "px4":
            acc = f"CAL_ACC{SLOTS[k]}"
            names = (f"{acc}_{{}}OFF", f"{acc}_{{}}SCALE", f"CAL_GYRO{SLOTS[k]}_{{}}OFF")
        else:
            n = ("", "2", "3")[k]
            acc = f"INS_ACC{n}"
            names = (f"{acc}OFFS_{{}}", f"{acc}SCAL_{{}}", f"INS_GYR{n}OFFS_{{}}")
        assert known[f"{acc}_ID"] == 1001 + k
        off, by, still = (np.array([known[one.format(a)] for a in "XYZ"]) for one in names)
        assert after(RAW[k], off, by) == pytest.approx(FORCE, abs=2e-5)
        assert after(RATES[k], still) == pytest.approx(TURN, abs=2e-6)


@pytest.mark.parametrize("name", ["fed.ulg", "ardupilot.bin"])
def test_what_parameters_cannot_make_good_is_refused(name: str, tmp_path: Path) -> None:
    form, log, parameters, _ = LOGS[name]
    turn = {"px4": "SENS_BOARD_ROT", "ardupilot": "AHRS_ORIENTATION"}[form]
    path = log(tmp_path / name, {**parameters(), turn: 8})
    with pytest.raises(UsageError, match=f"{turn} 8 turned its axes"):
        export(calibration_of(path, "imu0"), name, form)


def test_readings_of_a_chip_that_the_log_does_not_name_are_refused(tmp_path: Path) -> None:
    done = floats(after(RAW, OFFSET, SCALE), after(RATES, STILL))
    path = tmp_path / "1.ulg"
    path.write_bytes(ulog(STAMPS, *done, combined=True, parameters=of_px4()))
    with pytest.raises(UsageError, match="one of 3 sensors"):
        export(calibration_of(path, "imu0"), "x", "px4")


def test_parameters_that_changed_in_the_log_are_refused(tmp_path: Path) -> None:
    done = floats(after(RAW, OFFSET, SCALE), after(RATES, STILL))
    pairs = [*of_ardupilot().items(), ("INS_ACCOFFS_Y", 0.7)]
    path = tmp_path / "changed.bin"
    path.write_bytes(dataflash(STAMPS, *done, parameters=pairs))
    with pytest.raises(UsageError, match="INS_ACCOFFS_Y changed in it"):
        export(calibration_of(path, "imu0"), "x", "ardupilot")
    assert export(calibration_of(path, "imu1"), "x", "ardupilot").text


@pytest.mark.parametrize(
    ("name", "switch"),
    [
        ("px4.ulg", {"TC_A_ENABLE": 1, "TC_A2_ID": 1001}),
        ("ardupilot.bin", {"INS_TCAL1_ENABLE": 1}),
    ],
)
def test_a_stored_law_over_temperature_acts_once(
    name: str, switch: dict[str, float], tmp_path: Path
) -> None:
    """PX4 logs before it and would take it off what has it; ArduPilot logs after it."""
    form, log, parameters, _ = LOGS[name]
    plain = calibration_of(log(tmp_path / name, {**parameters(), **switch}), "imu0")
    own = stated(
        {"bias": (1.0, 2.0, 3.0), "scale": (0.0, 0.0, 0.0), "temperature_bias": (0.1, 0.2, 0.3)},
        raw_unit="m/s²", raw_to_si=1.0, valid={"temperature": (0.0, 50.0)},
    )  # fmt: skip
    warm = replace(own, sensor=plain.sensor)
    wrong, right = (plain, warm) if form == "px4" else (warm, plain)
    with pytest.raises(UsageError, match="law over temperature"):
        export(wrong, "x", form)
    assert export(right, "x", form).text


@pytest.mark.parametrize("name", LOGS)
def test_what_was_done_on_board_stays_with_the_calibration(name: str, tmp_path: Path) -> None:
    form, log, parameters, _ = LOGS[name]
    made = calibration_of(log(tmp_path / name, parameters()), "imu0")
    (tmp_path / "c.yaml").write_text(to_yaml(made), encoding="utf-8")
    again = from_dict(load(tmp_path / "c.yaml"), "c.yaml")
    assert again.sensor == made.sensor
    assert export(again, "x", form).text == export(made, "x", form).text


def test_a_log_after_other_parameters_is_not_corrected_again(tmp_path: Path) -> None:
    first = calibration_of(ardupilot_log(tmp_path / "1.bin", of_ardupilot()), "imu0")
    later = ardupilot_log(tmp_path / "2.bin", {**of_ardupilot(), "INS_ACCOFFS_X": 0.5})
    with pytest.raises(UsageError, match="controller's parameters are others"):
        accelerometer_of(first.sensor, read(later), "imu0")
    done = run("lab", tmp_path / "1.bin", later, "--sensor", "imu0", "--reference", "norm")
    assert "controller's parameters are others" in str(done.exception)
    same = ardupilot_log(tmp_path / "3.bin", of_ardupilot())
    assert accelerometer_of(first.sensor, read(same)).triad == "imu0"
