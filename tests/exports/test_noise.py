"""Noise at rest for other programs: each form through the formulas of the program's own code."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML

from imucalib.errors import Undetermined, UsageError
from imucalib.units import DEG, STANDARD_GRAVITY
from imucalib.writers import write
from worlds.command import run
from worlds.recordings import recording_of

HZ = 100.0
#: sd of a sample, and density, of what `night` holds.
SAMPLE = {"acceleration": 0.02, "angular_rate": 0.1 * DEG}
DENSITY = {quantity: sd / np.sqrt(HZ) for quantity, sd in SAMPLE.items()}


@pytest.fixture(scope="module")
def night(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten minutes at rest, moved once in between."""
    rng = np.random.default_rng(3)
    t = np.arange(60_000) / HZ
    moved = (t > 200.0) & (t < 205.0)
    force = np.array([0.0, 0.0, STANDARD_GRAVITY]) + 0.02 * rng.normal(size=(t.size, 3))
    force[t >= 205.0] += [0.5, 0.0, 0.0]
    rate = 0.1 * DEG * rng.normal(size=(t.size, 3))
    force[moved] += 3.0 * np.sin(9.0 * t[moved])[:, None]
    rate[moved] += np.cos(9.0 * t[moved])[:, None]
    path = tmp_path_factory.mktemp("night") / "night.h5"
    write(recording_of(t, force, rate, hz=HZ), path)
    return path


def form_of(recording: Path, form: str) -> str:
    result = run("noise", recording, "--to", form)
    assert result.exception is None, result.exception
    return result.stdout


def yaml_of(text: str) -> dict[str, Any]:
    """As OpenCV's FileStorage and every reader of YAML takes it."""
    return dict(YAML(typ="safe", pure=True).load(text.replace("%YAML:1.0", "")))


def test_the_table_tells_what_was_drawn(night: Path) -> None:
    rows = json.loads(run("noise", night, "--json").stdout)["noise"]
    assert [(r["quantity"], r["axis"]) for r in rows] == [(q, a) for q in SAMPLE for a in "xyz"]
    for row in rows:
        assert row["white"]["value"] == pytest.approx(DENSITY[row["quantity"]], rel=0.03)
        assert row["walk"]["value"] is None
        assert row["walk"]["below"] > 0.0
        middle, low, high = np.array(row["allan"]["fit"])
        assert np.all((low <= middle) & (middle <= high))
        assert middle[0] == pytest.approx(row["allan"]["deviation"][0], rel=0.03)


def test_files_hold_what_the_table_says_of_the_noisiest_axis(night: Path) -> None:
    """Of every term its own."""
    rows, kalibr = (
        json.loads(run("noise", night, "--json").stdout)["noise"],
        form_of(night, "kalibr"),
    )
    for key, value in yaml_of(kalibr).items():
        kind, _, term = key.partition("_")
        if term not in ("noise_density", "random_walk"):
            continue
        quantity = {"accelerometer": "acceleration", "gyroscope": "angular_rate"}[kind]
        name = {"noise_density": "white", "random_walk": "walk"}[term]
        own = [row[name] for row in rows if row["quantity"] == quantity]
        shown = [one["value"] for one in own if one["value"] is not None]
        assert value == max(shown or [one["below"] for one in own])


def test_densities_go_to_kalibr_and_openvins(night: Path) -> None:
    kalibr = yaml_of(form_of(night, "kalibr"))
    chain = yaml_of(form_of(night, "openvins"))["imu0"]
    for block in (kalibr, chain):
        assert block["accelerometer_noise_density"] == pytest.approx(
            DENSITY["acceleration"], rel=0.05
        )
        assert block["gyroscope_noise_density"] == pytest.approx(DENSITY["angular_rate"], rel=0.05)
        assert block["update_rate"] == pytest.approx(HZ)
        assert min(block["accelerometer_random_walk"], block["gyroscope_random_walk"]) > 0.0
    assert set(kalibr["upper_limits"]) == {"accelerometer_random_walk", "gyroscope_random_walk"}
    for name in ("Tw", "Ta", "R_IMUtoGYRO", "R_IMUtoACC"):
        assert np.array_equal(chain[name], np.eye(3))


def test_vins_adds_the_noise_of_a_sample(night: Path) -> None:
    """integration_base.h: each step of dt adds acc_n dt of velocity, and acc_w dt of bias."""
    vins, kalibr = yaml_of(form_of(night, "vins")), yaml_of(form_of(night, "kalibr"))
    dt, steps = 1.0 / HZ, 100  # one second
    for name, whole in (("acc", "accelerometer"), ("gyr", "gyroscope")):
        velocity = np.sqrt(steps) * vins[f"{name}_n"] * dt
        bias = np.sqrt(steps) * vins[f"{name}_w"] * dt
        assert velocity == pytest.approx(kalibr[f"{whole}_noise_density"], rel=1e-5)
        assert bias == pytest.approx(kalibr[f"{whole}_random_walk"], rel=1e-5)
    assert vins["acc_n"] == pytest.approx(SAMPLE["acceleration"], rel=0.05)


def test_orbslam_makes_samples_of_densities(night: Path) -> None:
    """Tracking.cc: noises times, and walks over, the root of IMU.Frequency."""
    slam = yaml_of(form_of(night, "orbslam3"))
    root = np.sqrt(slam["IMU.Frequency"])
    assert slam["IMU.NoiseAcc"] * root == pytest.approx(SAMPLE["acceleration"], rel=0.05)
    assert slam["IMU.NoiseGyro"] * root == pytest.approx(SAMPLE["angular_rate"], rel=0.05)
    assert min(slam["IMU.AccWalk"], slam["IMU.GyroWalk"]) > 0.0


def test_a_ros_message_has_the_variance_of_a_sample(night: Path) -> None:
    message = yaml_of(form_of(night, "ros"))
    names = {"linear_acceleration": "acceleration", "angular_velocity": "angular_rate"}
    for field, quantity in names.items():
        matrix = np.reshape(message[f"{field}_covariance"], (3, 3))
        assert np.count_nonzero(matrix - np.diag(np.diag(matrix))) == 0
        assert np.diag(matrix) == pytest.approx(SAMPLE[quantity] ** 2, rel=0.1)
    assert message["orientation_covariance"][0] == -1.0


def test_allan_deviations_are_a_table(night: Path) -> None:
    rows = list(csv.DictReader(io.StringIO(form_of(night, "allan-csv"))))
    first = next(r for r in rows if (r["quantity"], r["axis"]) == ("angular_rate", "z"))
    assert float(first["deviation"]) == pytest.approx(SAMPLE["angular_rate"], rel=0.03)
    assert all(float(r["low"]) < float(r["deviation"]) < float(r["high"]) for r in rows)
    ratio = [float(r["fit"]) / float(r["deviation"]) for r in rows if r["holds"] == "1"]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.05)


def test_a_sensor_that_is_missing_is_named(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    force = np.array([0.0, 0.0, STANDARD_GRAVITY]) + 0.02 * rng.normal(size=(12_000, 3))
    write(recording_of(np.arange(12_000) / HZ, force, hz=HZ), tmp_path / "acc.h5")
    result = run("noise", tmp_path / "acc.h5", "--to", "vins")
    assert isinstance(result.exception, UsageError)
    assert "VINS needs gyroscope_noise_density" in str(result.exception)
    assert run("noise", tmp_path / "acc.h5", "--to", "ros").exception is None


def test_a_recording_without_rest_has_no_noise(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    force = np.array([0.0, 0.0, STANDARD_GRAVITY]) + 0.02 * rng.normal(size=(6_000, 3))
    force += 2.0 * np.sin(np.arange(6_000) / 5.0)[:, None]
    write(recording_of(np.arange(6_000) / HZ, force, hz=HZ), tmp_path / "shaken.h5")
    result = run("noise", tmp_path / "shaken.h5")
    assert isinstance(result.exception, Undetermined)
