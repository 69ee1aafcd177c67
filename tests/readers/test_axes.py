"""Every axis has its own unit, scale, offset and fill: a file that states them reads as the same
numbers written plainly."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from imucalib import readers
from imucalib.errors import UnreadableInput
from imucalib.recording.mapping import FieldMapping, from_dict
from imucalib.recording.recording import Recording
from imucalib.units import ACCELERATION_UNITS, RATE_UNITS

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


@QUANTITIES
@AXES
def test_csv_reads_each_axis_by_its_own_heading(quantity: str, axis: int, tmp_path: Path) -> None:
    for unit, size in FAMILIES[quantity].items():
        units = [unit if k == axis else SI[quantity] for k in range(3)]
        sizes = np.array([size if k == axis else 1.0 for k in range(3)])
        heading = [f"{NAMES[quantity]}_{a} ({u})" for a, u in zip("xyz", units, strict=True)]
        rows = np.column_stack([T, si(quantity) / sizes])
        path = tmp_path / "a.csv"
        lines = [",".join(map(repr, row)) for row in rows.tolist()]
        path.write_text(",".join(["time (s)", *heading]) + "\n" + "\n".join(lines) + "\n")
        found = readers.read(path)
        assert_plain(found, quantity)
        assert_plain(readers.read(path, from_dict(found.mapping)), quantity)


@AXES
def test_an_axis_without_the_unit_of_the_others_is_refused(axis: int, tmp_path: Path) -> None:
    heading = [f"acc_{a}" + " (g)" * (k != axis) for k, a in enumerate("xyz")]
    lines = [",".join(map(repr, row)) for row in np.column_stack([T, si("acceleration")]).tolist()]
    path = tmp_path / "a.csv"
    path.write_text(",".join(["time (s)", *heading]) + "\n" + "\n".join(lines) + "\n")
    with pytest.raises(UnreadableInput, match=rf"{'xyz'[axis]} nothing.*--unit"):
        readers.read(path)
    assert_plain(readers.read(path, FieldMapping(acc_unit="m/s2")), "acceleration")


@AXES
def test_a_name_and_an_attribute_that_contradict_are_refused(axis: int, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time"] = T
        for k, values in enumerate(si("acceleration").T):
            name = f"acc_{'xyz'[k]}_mg" if k == axis else f"acc_{'xyz'[k]}"
            file[name] = values
            file[name].attrs["units"] = "m/s2"
    with pytest.raises(UnreadableInput, match=r"its name says mg.*--unit"):
        readers.read(tmp_path / "a.h5")
    found = readers.read(tmp_path / "a.h5", FieldMapping(acc_unit="m/s2"))
    assert_plain(found, "acceleration")


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
