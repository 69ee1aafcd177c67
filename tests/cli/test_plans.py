"""Plans and simulated recordings, as commands give them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result

from imucalib.errors import UsageError
from imucalib.readers import read
from imucalib.units import MG, STANDARD_GRAVITY
from worlds.command import run


def test_a_recommended_plan_is_judged_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "plan.csv"
    made = json.loads(run("design", "--recommend", 12, "-o", path, "--json").stdout)
    read = json.loads(run("design", path, "--json").stdout)
    assert read["positions"] == [
        {k: round(v, 1) for k, v in p.items()} for p in made["positions"]
    ]  # fmt: skip
    assert abs(read["norm_only"]["efficiency"] - made["norm_only"]["efficiency"]) < 1e-3


SMALL = ("--days", "0.1", "--rate", "2", "--noise", "0", "--rests", "1")


PLAIN = ("--plant", "scale=0,0,0", "--plant", "non_orthogonality=0,0,0", "--plant", "bias=0,0,0")


def simulate(*arguments: object) -> Result:
    return run("simulate", *arguments)


def readings(path: Path, name: str = "imu0/acceleration") -> np.ndarray:
    return read(path).channels[name].values


def test_a_worn_days_effects_are_in_its_samples(tmp_path: Path) -> None:
    path = tmp_path / "day.h5"
    done = simulate("actigraph", path, *SMALL, *PLAIN, "--plant", "quadratic=3,-2,4", "--json")
    content = json.loads(done.stdout)
    assert content["planted"]["quadratic"] == [3.0, -2.0, 4.0]
    assert content["written"] == [str(path)]
    reading, k = readings(path), np.array([3.0, -2.0, 4.0]) * MG / STANDARD_GRAVITY**2
    truth = reading.copy()
    for _ in range(20):  # reading = x + k x²
        truth = reading - k * truth**2
    np.testing.assert_allclose(np.linalg.norm(truth, axis=1), STANDARD_GRAVITY, rtol=1e-9)
    assert np.abs(np.linalg.norm(reading, axis=1) - STANDARD_GRAVITY).max() > 1.5 * MG


def test_a_worn_days_bias_follows_its_thermometer(tmp_path: Path) -> None:
    path = tmp_path / "day.h5"
    simulate("actigraph", path, *SMALL, *PLAIN, "--plant", "temperature_bias=2,0,-1")
    warm = readings(path, "imu0/temperature")
    assert np.ptp(warm) > 1.0
    truth = readings(path) - np.array([2.0, 0.0, -1.0]) * MG * (warm - 25.0)
    np.testing.assert_allclose(np.linalg.norm(truth, axis=1), STANDARD_GRAVITY, rtol=1e-9)
    assert "imu0/temperature" not in read(_cold(tmp_path)).channels


def _cold(folder: Path) -> Path:
    simulate("actigraph", folder / "cold.h5", *SMALL, "--no-temperature")
    return folder / "cold.h5"


FAULTS: list[tuple[str, Any]] = [
    ("gap@10:2", lambda a, b, c: (len(a) - len(b) == 200) and c == 1),
    ("freeze@10:2", lambda a, b, c: (np.ptp(b[1001:1199], axis=0) == 0).all()),
    ("sign@imu0:y", lambda a, b, c: np.array_equal(a * [1, -1, 1], b)),
    ("clip@0.5", lambda a, b, c: np.abs(b).max() <= 0.5 * STANDARD_GRAVITY * (1 + 1e-12)),
]


@pytest.mark.parametrize(("fault", "holds"), FAULTS, ids=[f[0] for f in FAULTS])
def test_faults_are_what_they_say(tmp_path: Path, fault: str, holds: Any) -> None:
    plain, broken = tmp_path / "plain.h5", tmp_path / "broken.h5"
    simulate("array", plain, "--rests", 3, "--seconds", 3)
    simulate("array", broken, "--rests", 3, "--seconds", 3, "--fault", fault)
    found = read(broken)
    assert holds(readings(plain), found.channels["imu0/acceleration"].values, len(found.gaps))


@pytest.mark.parametrize("fault", ["gap", "gap@1", "melt@1:2", "gap@x:2", "sign@imu0:w",
                                   "sign@imu99:x"])  # fmt: skip
def test_what_is_no_fault_is_refused(tmp_path: Path, fault: str) -> None:
    done = simulate("array", tmp_path / "a.h5", "--rests", 3, "--seconds", 1, "--fault", fault)
    assert isinstance(done.exception, UsageError)
    assert not (tmp_path / "a.h5").exists()


def test_a_benchs_recording_rests_four_seconds_with_four_mg_of_noise(tmp_path: Path) -> None:
    path = tmp_path / "rests.h5"
    done = simulate("lab", tmp_path / "b.csv", "--recording", path, "--positions", "12")
    assert done.exception is None
    values = readings(path)
    assert len(values) == 12 * 400 + 11 * 150  # 100 Hz, 1.5 s of motion between
    for k in range(12):
        rest = values[550 * k : 550 * k + 400]
        np.testing.assert_allclose(rest.std(axis=0), 4.0 * MG, rtol=0.2)
        np.testing.assert_allclose(rest[:200].mean(axis=0), rest[200:].mean(axis=0), atol=2.0 * MG)
