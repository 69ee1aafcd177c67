"""Units, axes and offsets that a file states, lacks or contradicts, in every format."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imucalib import readers
from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers import read
from imucalib.readers.fields.conversion import zero_g
from imucalib.readers.fields.joining import join
from imucalib.readers.fields.rates import FASTEST
from imucalib.recording.mapping import FieldMapping, from_dict, parse_axis_map
from imucalib.recording.recording import Recording
from imucalib.units import ACCELERATION_UNITS, DEG, RATE_UNITS
from worlds.command import run
from worlds.every_format import WRITE
from worlds.turned import turned

ROWS, RATE = 600, 100.0
NAMES = {"acceleration": "acc", "angular_rate": "gyr"}
FAMILIES = {"acceleration": ACCELERATION_UNITS, "angular_rate": RATE_UNITS}
SI = {"acceleration": "m/s2", "angular_rate": "rad/s"}
T = np.arange(ROWS) / RATE
QUANTITIES = pytest.mark.parametrize("quantity", NAMES)
AXES = pytest.mark.parametrize("axis", range(3))


def si(quantity: str) -> np.ndarray:
    rng = np.random.default_rng(len(quantity))
    middle = (
        np.array([2.0, -3.0, 9.1]) if quantity == "acceleration" else np.array([0.1, 0.2, -0.3])
    )
    return middle + rng.normal(scale=0.02, size=(ROWS, 3))


#: How one axis may differ -> (attributes of it, what is stored of SI values)
Stored = tuple[dict[str, object], Callable[[np.ndarray], np.ndarray]]
DIFFERENT: dict[str, Callable[[str], Stored]] = {
    "unit": lambda q: ({"units": list(FAMILIES[q])[1]},
                       lambda v: v / list(FAMILIES[q].values())[1]),
    "scale": lambda q: ({"units": SI[q], "scale_factor": 0.5}, lambda v: v / 0.5),
    "offset": lambda q: ({"units": SI[q], "add_offset": -3.25}, lambda v: v + 3.25),
    "all": lambda q: ({"units": list(FAMILIES[q])[2], "scale": 2.0, "add_offset": 7.0},
                      lambda v: (v / list(FAMILIES[q].values())[2] - 7.0) / 2.0),
}  # fmt: skip


def put_axes(path: Path, quantity: str, each: list[Stored], layout: str) -> Path:
    """Three datasets, the columns of a table, or one dataset with a list for every attribute."""
    columns = [pack(v) for (_, pack), v in zip(each, si(quantity).T, strict=True)]
    with h5py.File(path, "w") as file:
        file["time"] = T
        file["time"].attrs["units"] = "s"
        if layout == "datasets":
            for (attributes, _), letter, values in zip(each, "xyz", columns, strict=True):
                name = f"{NAMES[quantity]}_{letter}"
                file[name] = values
                file[name].attrs.update(attributes)
            return path
        node = file.create_dataset(quantity, data=np.stack(columns, axis=1))
        node.attrs["units"] = [str(a.get("units", "")) for a, _ in each]
        node.attrs["scale"] = [a.get("scale", a.get("scale_factor", 1.0)) for a, _ in each]
        node.attrs["add_offset"] = [a.get("add_offset", 0.0) for a, _ in each]
    return path


def assert_plain(found: Recording, quantity: str, rows: np.ndarray | slice = slice(None)) -> None:
    channel = found.channels[f"imu0/{quantity}"]
    assert channel.unit == SI[quantity]
    np.testing.assert_allclose(channel.values, si(quantity)[rows], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(channel.t, T[rows], atol=1e-12)


@QUANTITIES
@AXES
@pytest.mark.parametrize("how", DIFFERENT)
@pytest.mark.parametrize("layout", ["datasets", "list"])
def test_hdf5_reads_each_axis_by_its_own_attributes(
    quantity: str, axis: int, how: str, layout: str, tmp_path: Path
) -> None:
    plain: Stored = ({"units": SI[quantity]}, lambda v: v)
    each = [DIFFERENT[how](quantity) if k == axis else plain for k in range(3)]
    path = put_axes(tmp_path / "a.h5", quantity, each, layout)
    assert_plain(readers.read(path), quantity)


@AXES
@pytest.mark.parametrize("how", ["storage", "_FillValue", "missing_value"])
@pytest.mark.parametrize("layout", ["datasets", "table"])
def test_hdf5_takes_no_fill_of_any_axis_for_a_reading(
    axis: int, how: str, layout: str, tmp_path: Path
) -> None:
    values = si("acceleration").copy()
    values[200:300, axis] = -9999.0
    options = {"fillvalue": -9999.0} if how == "storage" else {}
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time"] = T
        if layout == "table":
            file.create_dataset("acceleration", data=values, chunks=(ROWS, 3), **options)
        for k in range(3) if layout == "datasets" else ():
            own = options if k == axis else {}
            file.create_dataset(f"acc_{'xyz'[k]}", data=values[:, k], chunks=(ROWS,), **own)
        node = file["acceleration" if layout == "table" else f"acc_{'xyz'[axis]}"]
        if how != "storage":
            node.attrs[how] = -9999.0
    rows = np.r_[0:200, 300:ROWS]
    found = readers.read(tmp_path / "a.h5", FieldMapping(acc_unit="m/s2", time_unit="s"))
    assert_plain(found, "acceleration", rows)
    assert found.gaps


def put_table(path: Path, heading: list[str], values: np.ndarray, t: np.ndarray = T) -> Path:
    lines = [",".join(map(repr, row)) for row in np.column_stack([t, values]).tolist()]
    path.write_text("\n".join([",".join(["time (s)", *heading]), *lines]) + "\n")
    return path


@QUANTITIES
@AXES
def test_csv_reads_each_axis_by_its_own_heading(quantity: str, axis: int, tmp_path: Path) -> None:
    for unit, size in FAMILIES[quantity].items():
        units = [unit if k == axis else SI[quantity] for k in range(3)]
        sizes = np.array([size if k == axis else 1.0 for k in range(3)])
        heading = [f"{NAMES[quantity]}_{a} ({u})" for a, u in zip("xyz", units, strict=True)]
        path = put_table(tmp_path / "a.csv", heading, si(quantity) / sizes)
        found = readers.read(path)
        assert_plain(found, quantity)
        assert_plain(readers.read(path, from_dict(found.mapping)), quantity)


@AXES
def test_an_axis_without_the_unit_of_the_others_is_refused(axis: int, tmp_path: Path) -> None:
    heading = [f"acc_{a}" + " (g)" * (k != axis) for k, a in enumerate("xyz")]
    path = put_table(tmp_path / "a.csv", heading, si("acceleration"))
    with pytest.raises(UnreadableInput, match=rf"{'xyz'[axis]} nothing.*--unit"):
        readers.read(path)
    assert_plain(readers.read(path, FieldMapping(acc_unit="m/s2")), "acceleration")


def test_a_name_and_an_attribute_that_contradict_are_refused(tmp_path: Path) -> None:
    plain: Stored = ({"units": "m/s2"}, lambda v: v)
    path = put_axes(tmp_path / "a.h5", "acceleration", [plain] * 3, "datasets")
    with h5py.File(path, "a") as file:
        file.move("acc_y", "acc_y_mg")
    with pytest.raises(UnreadableInput, match=r"its name says mg.*--unit"):
        readers.read(path)
    assert_plain(readers.read(path, FieldMapping(acc_unit="m/s2")), "acceleration")


CLOCKS: dict[str, tuple[np.ndarray, dict[str, object], int | None]] = {
    "packed": (np.arange(ROWS), {"units": "seconds", "scale_factor": 0.01}, None),
    "packed from an offset": (np.arange(ROWS) - 300, {"units": "s", "scale_factor": 0.01,
                                                      "add_offset": 3.0}, None),
    "packed since": (np.arange(ROWS), {"units": "seconds since 2023-11-14T22:13:20Z",
                                       "scale_factor": 0.01}, 1_700_000_000_000_000_000),
    "days since": (T / 86_400, {"units": "days since 2023-11-14 22:13:20"},
                   1_700_000_000_000_000_000),
    "hours since": (T / 3600 + 1.0, {"units": "hours since 2023-11-14 21:13:20"},
                    1_700_000_000_000_000_000),
    "minutes": (T / 60, {"units": "min"}, None),
    "filetime": (np.rint(T * 1e7).astype(np.int64) + 133_444_736_000_000_000, {},
                 1_700_000_000_000_000_000),
}  # fmt: skip


@pytest.mark.parametrize("form", CLOCKS)
def test_hdf5_reads_a_clock_by_its_own_attributes(form: str, tmp_path: Path) -> None:
    stamps, attributes, start = CLOCKS[form]
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["acceleration"] = si("acceleration")
        file["time"] = stamps
        file["time"].attrs.update(attributes)
    found = readers.read(tmp_path / "a.h5", FieldMapping(acc_unit="m/s2"))
    channel = found.channels["imu0/acceleration"]
    np.testing.assert_allclose(channel.t, T, atol=1e-6)
    assert found.start_ns == (start if start is None else pytest.approx(start, abs=1e4))


RATES = FieldMapping(gyro_unit="rad/s")
BY_FORMAT = pytest.mark.parametrize("name", WRITE)


def test_every_format_that_fixes_no_unit_is_written() -> None:
    """Its line in `worlds.every_format` is what the laws of units, parts and bombs run on."""
    assert set(WRITE) == {r.name for r in readers.readers() if not getattr(r, "fixed", False)}


@BY_FORMAT
@pytest.mark.parametrize("peak", [1.0, 4.0])
def test_degrees_called_radians_are_refused_with_what_reads_them(
    name: str, peak: float, tmp_path: Path
) -> None:
    t, acc, rate = turned(peak=peak)
    path = WRITE[name](tmp_path, t, acc, rate / DEG)
    assert (np.abs(rate / DEG).max() > FASTEST) == (peak > 1.5)
    for each in (readers.read, lambda *a: list(readers.blocks(*a, block_samples=2000))):
        with pytest.raises(UnreadableInput, match="--gyro-unit deg/s"):
            each(path, RATES)
    found = readers.read(path, replace(RATES, gyro_unit="deg/s"))
    np.testing.assert_allclose(found.channels["imu0/angular_rate"].values, rate, atol=1e-4)


@pytest.mark.parametrize("true", ["rad/s", "deg/s", "mdeg/s"])
def test_a_unit_that_nobody_states_is_named_where_turns_prove_it(true: str, tmp_path: Path) -> None:
    t, acc, rate = turned()
    path = tmp_path / "log.csv"
    table = np.column_stack([t, acc, rate / RATE_UNITS[true]])
    names = [f"{q}_{a}" for q in ("acc", "gyro") for a in "xyz"]
    np.savetxt(path, table, delimiter=",", header=",".join(["time_s", *names]), comments="")
    found = readers.read(path)
    np.testing.assert_allclose(found.channels["imu0/angular_rate"].values, rate, atol=1e-6)
    assert sum(f"in {true}, and is read so" in note for note in found.notes) == 1
    assert not [note for note in found.notes if "--gyro-unit" in note]
    assert found.mapping["gyro_unit"] == true
    again = join(readers.blocks(path, block_samples=97), "")
    np.testing.assert_array_equal(
        again.channels["imu0/angular_rate"].values, found.channels["imu0/angular_rate"].values
    )
    assert again.notes == found.notes


@pytest.mark.parametrize("axes", ["-x,-y,z", "-x,y,z", "y,-z,x"])
@pytest.mark.parametrize("true", ["rad/s", "deg/s"])
def test_axes_that_differ_refute_no_unit(true: str, axes: str, tmp_path: Path) -> None:
    t, acc, rate = turned()
    path = tmp_path / "log.csv"
    table = np.column_stack([t, acc, parse_axis_map(axes).apply(rate) / RATE_UNITS[true]])
    names = [f"{q}_{a}" for q in ("acc", "gyro") for a in "xyz"]
    np.savetxt(path, table, delimiter=",", header=",".join(["time_s", *names]), comments="")
    stated = readers.read(path, FieldMapping(gyro_unit=true))
    found = readers.read(path)
    np.testing.assert_allclose(
        found.channels["imu0/angular_rate"].values,
        stated.channels["imu0/angular_rate"].values,
        rtol=1e-12,
    )
    other = "rad/s" if true == "deg/s" else "deg/s"
    with pytest.raises(UnreadableInput, match=f"--gyro-unit {true}"):
        readers.read(path, FieldMapping(gyro_unit=other))


_LEVEL, _SCALE = np.array([33123.0, 33276.0, 32360.0]), np.array([4076.0, 4006.0, 4052.0])


def _directions(rng: np.random.Generator, count: int) -> Array:
    out = rng.normal(size=(count, 3))
    return out / np.linalg.norm(out, axis=1, keepdims=True)


def _recording(path: Path) -> Path:
    """36 rests of 4 s at 50 Hz, half a second of turning between them."""
    rng = np.random.default_rng(5)
    rests = [np.repeat(u[None], 200, axis=0) for u in _directions(rng, 36)]
    turns = [rng.normal(0.0, 0.6, (25, 3)) for _ in rests]
    truth = np.concatenate([part for both in zip(rests, turns, strict=True) for part in both])
    counts = np.rint(_LEVEL + _SCALE * truth + rng.normal(0.0, 6.0, truth.shape))
    np.savetxt(path, np.column_stack([np.arange(len(counts)) / 50.0, counts]), fmt="%.7e")
    return path


def test_a_recording_from_an_offset_is_refused_with_the_options_that_read_it(
    tmp_path: Path,
) -> None:
    log = _recording(tmp_path / "acc.txt")
    refused = run("inspect", log)
    assert isinstance(refused.exception, UnreadableInput)
    told = str(refused.exception)
    assert "counted from an offset" in told
    line = refused.exception.add
    assert shlex.join(line).startswith("--unit counts --lsb 40")
    assert told.endswith(shlex.join(line))
    done = run("lab", log, "--reference", "norm", "-o", tmp_path / "out", "--full", *line)
    assert done.exception is None, done.stderr
    assert "as the recording was read" in " ".join(done.stdout.split())


@given(
    seed=st.integers(0, 10_000),
    away=st.floats(1.5, 12.0),
    size=st.sampled_from([0.33, 66.0, 1024.0, 4096.0]),
)
def test_the_level_and_what_a_g_reads_come_back(seed: int, away: float, size: float) -> None:
    rng = np.random.default_rng(seed)
    level = away * size * _directions(rng, 1)[0]
    rest = level + size * _directions(rng, 30) * rng.uniform(0.98, 1.02, (1, 3))
    found = zero_g(rest)
    assert found is not None
    assert found.radius == pytest.approx(size, rel=0.05)
    assert np.abs(found.level - level).max() < 0.05 * size


@pytest.mark.parametrize("stated", [True, False])
def test_acceleration_without_gravity_is_said_to_be_that(stated: bool, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    t = np.arange(2000) / 100.0
    moved = rng.normal(0.0, 0.02, (2000, 3)) + np.sin(t)[:, None] * (t[:, None] % 4 > 2)
    head = "t_s,acc_x [m/s2],acc_y [m/s2],acc_z [m/s2]" if stated else "t_s,acc_x,acc_y,acc_z"
    path = tmp_path / "linear.csv"
    np.savetxt(path, np.column_stack([t, moved]), delimiter=",", header=head, comments="")
    with pytest.raises(UnreadableInput, match="no gravity: it was removed"):
        read(path)


def acc() -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.array([0.3, -0.4, 9.7]) + rng.normal(scale=0.02, size=(400, 3))


@pytest.mark.parametrize("where", ["serial=B07", "id=2", "1=B07"])
@pytest.mark.parametrize("time", [True, False])
def test_rows_are_selected_by_a_value(where: str, time: bool, tmp_path: Path) -> None:
    lines = ["serial,id," + "time (s)," * time + "acc_x (m/s2),acc_y (m/s2),acc_z (m/s2)"]
    for k, a in enumerate(acc().tolist()):
        stamp = [f"{0.01 * k:.2f}"] * time
        lines.append(",".join([*(("A12", "1.0"), ("B07", "2.0"))[k // 200], *stamp, *map(repr, a)]))
    path = tmp_path / "two.csv"
    path.write_text("\n".join(lines) + "\n")
    mapping = FieldMapping(where=(where,), rate=None if time else 100.0)
    found = readers.read(path, mapping)
    parts = join(readers.blocks(path, mapping, block_samples=30), "")
    for one in (found, readers.read(path, from_dict(found.mapping)), parts):
        np.testing.assert_array_equal(one.channels["imu0/acceleration"].values, acc()[200:])
        assert not any("serial" in note for note in one.notes)


@pytest.mark.parametrize("name", ["csv", "hdf5", "mcap"])
@pytest.mark.parametrize("step", [2e-6, 30.0])
def test_a_rate_that_no_sensor_has_is_refused(name: str, step: float, tmp_path: Path) -> None:
    path = WRITE[name](tmp_path, np.arange(400) * step, acc(), np.zeros((400, 3)))
    with pytest.raises(UnreadableInput, match=r"samples a second.*--time-unit.*--rate"):
        readers.read(path)
    with pytest.raises(UnreadableInput, match=r"samples a second"):
        list(readers.blocks(path, block_samples=50))
    assert readers.read(path, FieldMapping(rate=50.0)).channels


@pytest.mark.parametrize(
    ("modulus", "unit"),
    [(2**32, "ms"), (2**32, "us"), (2**16, "ms"), (2**24, "us"), (86_400_000, "ms"), (3600, "s")],
)
@pytest.mark.parametrize("name", ["csv", "matlab"])
def test_a_counter_that_wraps_is_unrolled(
    name: str, modulus: int, unit: str, tmp_path: Path
) -> None:
    whole = modulus * {"s": 1.0, "ms": 1e-3, "us": 1e-6}[unit]
    true = 0.02 * np.arange(400)
    t = np.round((whole - 1.5 + true) % whole, 6)
    if name == "csv":
        path = put_table(tmp_path / "a.csv", [f"acc_{a} (m/s2)" for a in "xyz"], acc(), t)
    else:
        path = WRITE[name](tmp_path, t, acc(), np.zeros((400, 3)))
    found = readers.read(path)
    t = found.channels["imu0/acceleration"].t
    np.testing.assert_allclose(t - t[0], true, atol=1e-5)
    assert not found.gaps
    assert any("begin again" in note for note in found.notes)
    parts = list(readers.blocks(path, block_samples=64))
    t = np.concatenate([p.channels["imu0/acceleration"].t for p in parts])
    np.testing.assert_allclose(t - t[0], true, atol=1e-5)
