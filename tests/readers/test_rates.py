"""Angular rates whose unit is not the stated one: refused by every reader, with the option that
settles it, for what no gyroscope reads and for what turns between rests contradict."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imucalib import readers
from imucalib.errors import UnreadableInput
from imucalib.readers.rates import FASTEST, carried
from imucalib.recording.mapping import FieldMapping
from imucalib.units import DEG, RATE_UNITS
from worlds.every_format import WRITE
from worlds.places import MEASURED
from worlds.turned import turned

RATES = FieldMapping(gyro_unit="rad/s")
BY_FORMAT = pytest.mark.parametrize("name", WRITE)


@BY_FORMAT
@pytest.mark.parametrize("peak", [1.0, 4.0])
def test_degrees_called_radians_are_refused_with_what_reads_them(
    name: str, peak: float, tmp_path: Path
) -> None:
    t, acc, rate = turned(peak=peak)
    path = WRITE[name](tmp_path, t, acc, rate / DEG)
    assert (np.abs(rate / DEG).max() > FASTEST) == (peak > 1.5)
    for read in (readers.read, lambda *a: list(readers.blocks(*a, block_samples=2000))):
        with pytest.raises(UnreadableInput, match="--gyro-unit deg/s"):
            read(path, RATES)
    found = readers.read(path, replace(RATES, gyro_unit="deg/s"))
    np.testing.assert_allclose(found.channels["imu0/angular_rate"].values, rate, atol=1e-4)


@pytest.mark.parametrize("true", ["rad/s", "mdeg/s", "mrad/s"])
def test_any_unit_called_another_is_refused(true: str, tmp_path: Path) -> None:
    t, acc, rate = turned(turns=4)
    path = WRITE["csv"](tmp_path, t, acc, rate / RATE_UNITS[true])
    with pytest.raises(UnreadableInput, match="gyro-unit"):
        readers.read(path, FieldMapping(gyro_unit="deg/s"))
    readers.read(path, FieldMapping(gyro_unit=true))


@pytest.mark.parametrize("true", ["rad/s", "deg/s", "mdeg/s"])
def test_a_unit_that_nobody_states_is_named_where_turns_prove_it(true: str, tmp_path: Path) -> None:
    t, acc, rate = turned()
    path = tmp_path / "log.csv"
    table = np.column_stack([t, acc, rate / RATE_UNITS[true]])
    names = [f"{q}_{a}" for q in ("acc", "gyro") for a in "xyz"]
    np.savetxt(path, table, delimiter=",", header=",".join(["time_s", *names]), comments="")
    found = readers.read(path)
    assert found.channels["imu0/angular_rate"].unit == "counts"
    assert sum(f"give --gyro-unit {true}" in note for note in found.notes) == 1
    again = readers.read(path, FieldMapping(gyro_unit=true))
    np.testing.assert_allclose(again.channels["imu0/angular_rate"].values, rate, atol=1e-6)
    assert not [note for note in again.notes if "--gyro-unit" in note]


def test_gravity_is_carried_to_where_it_is_read() -> None:
    t, acc, rate = turned(turns=8, peak=3.0)
    errors = np.array(carried(t, acc, rate, np.array([1.0, DEG, 1.0 / DEG])))
    assert len(errors) == 8
    assert errors[:, 0].max() < 0.5 * DEG
    assert np.median(errors[:, 1:], axis=0).min() > 20.0 * DEG


@pytest.mark.parametrize("name", ["imu0.log.gz", "imu1.log.gz"])
def test_a_measured_log_proves_its_unit(name: str) -> None:
    mapping = FieldMapping(
        acc=("1", "2", "3"), gyro=("4", "5", "6"), rate=100.0, header=False, acc_unit="m/s2",
        gyro_unit="rad/s",
    )  # fmt: skip
    readers.read(MEASURED / name, mapping)
    with pytest.raises(UnreadableInput, match="--gyro-unit rad/s"):
        readers.read(MEASURED / name, replace(mapping, gyro_unit="deg/s"))
