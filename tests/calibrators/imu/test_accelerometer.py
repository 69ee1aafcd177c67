"""What the accelerometer of an IMU lacks, told by rests and turns together, on worlds made here."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from worlds.command import run
from worlds.turned_imu import Array, Log, chip, turned


def report(*arguments: object) -> dict:  # type: ignore[type-arg]
    result = run("imu", *arguments, "--json", "-q")
    assert result.exception is None, result.exception
    return json.loads(result.stdout)  # type: ignore[no-any-return]


def world(seed: int, rests: int = 24) -> Log:
    rng = np.random.default_rng(seed)
    return turned(chip(rng), rng, rests=rests)


def product(log: Log) -> Array:
    return np.asarray(4e-3 * log.up[:, 1] * log.up[:, 2])


def square(log: Log) -> Array:
    return np.asarray(4e-3 * log.up[:, 0] ** 2)


def drift(log: Log) -> Array:
    return np.asarray(3e-3 * log.t / log.t[-1])


PLANTED = [
    pytest.param(product, "product_across", 0, "product_across_x", 4.0, id="product"),
    pytest.param(square, "quadratic", 0, "quadratic_x", 4.0, id="square"),
    pytest.param(drift, "bias_drift", 2, "bias_drift_z", 3.0, id="drift", marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("added", "name", "axis", "parameter", "size"), PLANTED)
@pytest.mark.parametrize("seed", [71, pytest.param(72, marks=pytest.mark.slow)])
def test_turns_tell_what_sizes_of_gravity_cannot(
    added, name: str, axis: int, parameter: str, size: float, seed: int, tmp_path: Path
) -> None:  # type: ignore[no-untyped-def]
    """24 rests are 24 numbers for the nine of the accelerometer: effects of twenty times the noise
    went without a certain name, and once were the gyroscope's."""
    log = world(seed)
    force = log.force.copy()
    force[:, axis] += added(log)
    content = report(replace(log, force=force).write(tmp_path / "log.csv"))
    told = content["loop"]["steps"]
    assert [step["effect"] for step in told] == [name]
    assert content["loop"]["verdict"] == "explained"
    # What the sizes of gravity alone cannot tell is no advice where the turns have told it.
    assert not any("cannot tell" in step for step in content["card"]["to_do"])
    held = [error["held_out"] for error in content["loop"]["errors"]]
    assert held[0]["final"] < 0.7 * held[0]["base"]
    assert held[1]["final"] < 0.4
    (own,) = (p for p in content["parameters"] if p["name"] == parameter)
    assert abs(own["value"] - size) < 3.0 * own["sd"]
    assert own["sd"] < 0.4


def test_a_rest_that_is_none_moves_nothing(tmp_path: Path) -> None:
    """A push of 40 mg along gravity during one rest: told, and no part of the answer."""
    log = world(73)
    a, b = log.still[7]
    pushed = ((log.t > a - 0.2) & (log.t < b + 0.2))[:, None]
    force = log.force + 0.04 * pushed * log.up
    plain = report(log.write(tmp_path / "plain.csv"), "--no-loop")
    content = report(replace(log, force=force).write(tmp_path / "pushed.csv"))
    assert content["exit_code"] == 0
    assert any(note.startswith("row 8: ") for note in content["notes"])
    before = {p["name"]: p for p in plain["parameters"]}
    for p in content["parameters"]:
        assert abs(p["value"] - before[p["name"]]["value"]) < 4.0 * p["sd"] + 1e-9


def test_what_is_not_corrected_has_the_error_of_the_base(tmp_path: Path) -> None:
    """A part of the log may be corrected by another name: that is no error of this calibration."""
    log = world(71)
    force = log.force.copy()
    force[:, 0] += square(log)
    path = replace(log, force=force).write(tmp_path / "log.csv")
    content = report(path, "--without", "quadratic", "--no-curves")
    assert not content["loop"]["steps"]
    assert content["loop"]["unexplained"]
    for error in content["loop"]["errors"]:
        assert error["held_out"]["final"] == error["held_out"]["base"]
