"""One vocabulary for all formats: equal names are equal readings, and what is not read is named."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from imucalib import readers
from imucalib.arrays import Array
from worlds.one_table import FORMATS, N, Table, written_hdf5


def axes(name: str) -> list[str]:
    return [f"{name}_{axis}" for axis in "xyz"]


FORCES = {
    name: axes(name)
    for name in (
        "acc", "accel", "acce", "acceleration", "accelerometer", "linear_acceleration", "lin_acc",
        "linacc", "specific_force", "specificForce", "acc_raw", "a", "f", "ACC", "imu_accel",
        "accelerometer_m_s2", "beschleunigung",
    )
} | {"ax": ["ax", "ay", "az"], "xacc": ["xacc", "yacc", "zacc"]}  # fmt: skip
TURNS = {
    name: axes(name)
    for name in (
        "gyr", "gyro", "gyroscope", "angular_velocity", "angularVelocity", "rotation_rate",
        "rotationRate", "omega", "w", "ang_vel", "angvel", "angular_rate", "gyro_rad", "body_rate",
        "turn_rate", "gyro_raw", "drehrate",
    )
} | {
    "p": ["p", "q", "r"],
    "rollspeed": ["rollspeed", "pitchspeed", "yawspeed"],
    "xgyro": ["xgyro", "ygyro", "zgyro"],
}  # fmt: skip
OTHERS = {
    name: axes(name)
    for name in ("mag", "angular_acceleration", "gyro_bias", "velocity", "foo", "orientation")
}


def table_of(force: Sequence[str], others: Sequence[str]) -> dict[str, Array]:
    rng = np.random.default_rng(1)
    acc = np.array([0.0, 0.0, 9.81]) + rng.normal(scale=0.02, size=(N, 3))
    rates = rng.normal(scale=0.01, size=(N, 3))
    return dict(zip((*force, *others), [*acc.T, *rates.T], strict=True))


def readings(path: Path) -> dict[str, Array]:
    return {c.quantity: c.values for c in readers.read(path).channels.values()}


def notes_in(path: Path) -> str:
    return "\n".join(readers.read(path).notes)


@pytest.mark.parametrize("write", FORMATS)
@pytest.mark.parametrize(
    ("quantity", "name"),
    [*(("acceleration", n) for n in FORCES), *(("angular_rate", n) for n in TURNS)],
)
def test_a_quantity_is_known_by_its_name_in_every_format(
    quantity: str, name: str, write: Callable[[Path, Table], Path], tmp_path: Path
) -> None:
    own = (FORCES if quantity == "acceleration" else TURNS)[name]
    force = quantity == "acceleration"
    table = table_of(own, axes("gyr")) if force else table_of(axes("acc"), own)
    found = readings(write(tmp_path / "log", table))
    assert set(found) == {"acceleration", "angular_rate"}
    expected = np.column_stack([table[axis] for axis in own])
    np.testing.assert_array_equal(found[quantity], expected)


@pytest.mark.parametrize("write", FORMATS)
@pytest.mark.parametrize("name", OTHERS)
def test_what_is_not_read_is_named_in_every_format(
    name: str, write: Callable[[Path, Table], Path], tmp_path: Path
) -> None:
    path = write(tmp_path / "log", table_of(axes("acc"), OTHERS[name]))
    assert set(readings(path)) == {"acceleration"}
    assert f"{name}_" in notes_in(path)


@pytest.mark.parametrize("write", FORMATS)
def test_two_sensors_of_one_table_are_two_in_every_format(
    write: Callable[[Path, Table], Path], tmp_path: Path
) -> None:
    table = table_of(axes("left_acc"), axes("right_acc"))
    table |= {"right_acc_z": table["right_acc_z"] + 9.81}
    force = {
        c.triad: c.values for c in readers.read(write(tmp_path / "log", table)).channels.values()
    }
    assert set(force) == {"left", "right"}
    expected = np.column_stack([table[axis] for axis in axes("left_acc")])
    np.testing.assert_array_equal(force["left"], expected)


def test_the_folder_of_an_axis_tells_its_quantity(tmp_path: Path) -> None:
    nested = [f"{sensor}/{axis}" for sensor in ("accelerometer", "gyroscope") for axis in "xyz"]
    table = table_of(nested[:3], nested[3:])
    found = readings(written_hdf5(tmp_path / "log", table))
    np.testing.assert_array_equal(found["angular_rate"][:, 1], table["gyroscope/y"])
    np.testing.assert_array_equal(found["acceleration"][:, 2], table["accelerometer/z"])
