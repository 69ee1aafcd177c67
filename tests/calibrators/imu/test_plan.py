"""Turns to take: what a plan promises, by a simulation of it; what a log leaves open."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from imucalib.calibrators.imu.plan import hand_plan, of_turn
from worlds.command import run


def test_a_plan_states_what_it_gives(tmp_path: Path) -> None:
    """The gains of logs that follow the plan, with errors as large as it assumes."""
    content = json.loads(run("design", "--imu", "--recommend", "20", "--json").stdout)
    assert len(content["turns"]) == 19
    assert content["open"] == []
    few = json.loads(run("design", "--imu", "--recommend", "12", "--json").stdout)
    assert all(few["sd"][name] > sd for name, sd in content["sd"].items())
    rng, plan = np.random.default_rng(1), hand_plan(20)
    rows = np.concatenate([of_turn(t.up, np.radians(135.0) * _signed(t.axis)) for t in plan.turns])
    found = [
        np.linalg.lstsq(rows, np.radians(0.1) * rng.normal(size=len(rows)), rcond=None)[0]
        for _ in range(400)
    ]
    np.testing.assert_allclose(np.std(found, axis=0), plan.sd, rtol=0.15)


def _signed(axis: str) -> np.ndarray:
    return (-1.0 if axis[0] == "-" else 1.0) * np.eye(3)["xyz".index(axis[1])]


def test_what_a_log_leaves_open_is_told_with_the_turns_that_show_it(tmp_path: Path) -> None:
    log, made = tmp_path / "turns.h5", tmp_path / "out"
    assert run("simulate", "imu", log, "--rests", "14", "-q").exception is None
    assert run("imu", log, "-o", made, "--no-loop", "-q").exception is None
    content = json.loads(run("design", "--imu", made / "calibration.yaml", "--json").stdout)
    assert len(content["turns"]) == 3
    assert all(content["sd"][name] < sd for name, sd in content["sd_before"].items())
    page = run("design", "--imu", made / "calibration.yaml").stdout
    assert "3 more turns" in page


@pytest.mark.slow
def test_what_is_simulated_is_found(tmp_path: Path) -> None:
    log = tmp_path / "turns.h5"
    words = ("--plant", "gyro_g_sensitivity=0.1", "--late", "0.004", "--seed", "5", "--json")
    made = json.loads(run("simulate", "imu", log, *words).stdout)
    content = json.loads(run("imu", log, "--json", "-q").stdout)
    assert [s["effect"] for s in content["loop"]["steps"]] == ["gyro_g_sensitivity"]
    own = {p["name"]: p for p in content["parameters"]}
    for i, a in enumerate("xyz"):
        for j, b in enumerate("xyz"):
            p = own[f"gyro_gain_{a}{b}"]
            assert abs(p["value"] - made["gyro_gain"][i][j]) < 5.0 * p["sd"]
            assert abs(own[f"gyro_g_sensitivity_{a}{b}"]["value"] - 0.1) < 0.02
    late = content["imu"]["gyroscope_late_s"]
    assert abs(late["value"] - 0.004) < 4.0 * late["sd"]
