"""A clock belongs to a sensor and a label to an axis; a rate is samples over time."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

import h5py
import numpy as np
import pytest

from imucalib import readers
from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.inspection.inspection import inspect_recording
from imucalib.recording.mapping import from_dict
from worlds.logger_files import gene_file, gene_page

N, RATE = 400, 100.0


def vectors(n: int = N, mean: float = 9.81, seed: int = 0) -> Array:
    rng = np.random.default_rng(seed)
    return np.round(np.array([0.1, 0.2, mean]) + rng.normal(scale=0.02, size=(n, 3)), 5)


def written(path: Path, names: Sequence[str], columns: Sequence[Sequence[object]]) -> Path:
    rows = zip(*columns, strict=True)
    lines = [",".join(names), *(",".join(map(str, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


ACC, GYR = vectors(), vectors(mean=0.0, seed=1)
T = np.round(np.arange(N) / RATE, 2)


@pytest.mark.parametrize(
    "names",
    [
        "acc_time acc_x acc_y acc_z gyro_time gyr_x gyr_y gyr_z",
        "t acc_x acc_y acc_z t gyr_x gyr_y gyr_z",
        "X[s] ACC.X[m/s2] ACC.Y[m/s2] ACC.Z[m/s2] X[s] GYRO.X[rad/s] GYRO.Y[rad/s] GYRO.Z[rad/s]",
    ],
)
def test_each_sensor_of_a_table_has_its_own_clock(names: str, tmp_path: Path) -> None:
    columns = [T.tolist(), *ACC.T.tolist(), (T + 3.0).tolist(), *GYR.T.tolist()]
    path = written(tmp_path / "log.csv", names.split(), columns)
    found = readers.read(path)
    acc, gyr = (found.channels[f"imu0/{q}"] for q in ("acceleration", "angular_rate"))
    np.testing.assert_allclose(acc.t, T, atol=1e-9)
    np.testing.assert_allclose(gyr.t, T + 3.0, atol=1e-9)
    np.testing.assert_array_equal(gyr.values, GYR)
    again = readers.read(path, from_dict(found.mapping))
    np.testing.assert_array_equal(again.channels["imu0/angular_rate"].t, gyr.t)


def test_a_sensor_at_half_the_rate_keeps_its_time(tmp_path: Path) -> None:
    half = [*(T[: N // 2] * 2).tolist(), *[""] * (N // 2)]
    gyr = [[*axis[: N // 2], *[""] * (N // 2)] for axis in GYR.T.tolist()]
    names = ["acc_time", "acc_x", "acc_y", "acc_z", "gyro_time", "gyr_x", "gyr_y", "gyr_z"]
    path = written(tmp_path / "log.csv", names, [T.tolist(), *ACC.T.tolist(), half, *gyr])
    found = readers.read(path)
    assert found.channels["imu0/acceleration"].rate == pytest.approx(RATE)
    assert found.channels["imu0/angular_rate"].rate == pytest.approx(RATE / 2)
    np.testing.assert_allclose(found.channels["imu0/angular_rate"].t, T[: N // 2] * 2, atol=1e-9)
    pieces = [b.channels["imu0/angular_rate"].t for b in readers.blocks(path, block_samples=50)
              if "imu0/angular_rate" in b.channels]  # fmt: skip
    np.testing.assert_allclose(np.concatenate(pieces), T[: N // 2] * 2, atol=1e-9)


def test_two_stamps_of_the_same_rows_are_one_clock(tmp_path: Path) -> None:
    names = ["time", "seconds_elapsed", "acc_x", "acc_y", "acc_z", "gyr_x", "gyr_y", "gyr_z"]
    columns = [T.tolist(), (T + 7.0).tolist(), *ACC.T.tolist(), *GYR.T.tolist()]
    found = readers.read(written(tmp_path / "log.csv", names, columns))
    times = [c.t for c in found.channels.values()]
    np.testing.assert_array_equal(times[0], times[1])


def test_the_clock_of_something_else_between_sensors_is_none_of_theirs(tmp_path: Path) -> None:
    names = ["time", "acc_x", "acc_y", "acc_z", "gps_time", "gyr_x", "gyr_y", "gyr_z"]
    columns = [T.tolist(), *ACC.T.tolist(), (T * 2 + 7.0).tolist(), *GYR.T.tolist()]
    found = readers.read(written(tmp_path / "log.csv", names, columns))
    np.testing.assert_allclose(found.channels["imu0/angular_rate"].t, T, atol=1e-9)
    assert any("not read: gps_time" in note for note in found.notes)


def test_a_row_of_means_below_a_table_is_no_sample(tmp_path: Path) -> None:
    columns = [[*column, float(np.mean(column))] for column in (T.tolist(), *ACC.T.tolist())]
    names = ["time", "acc_x", "acc_y", "acc_z"]
    found = readers.read(written(tmp_path / "log.csv", names, columns))
    assert found.channels["imu0/acceleration"].t.size == N
    assert any("below the table" in note for note in found.notes)
    assert found.gaps == ()


def test_dates_in_seconds_under_a_heading_in_ms_are_dates(tmp_path: Path) -> None:
    stamps = [f"{1_700_000_000 + t:.2f}" for t in T]
    names = ["timestamp_ms", "acc_x", "acc_y", "acc_z"]
    found = readers.read(written(tmp_path / "log.csv", names, [stamps, *ACC.T.tolist()]))
    assert found.channels["imu0/acceleration"].rate == pytest.approx(RATE)
    assert any("dates in s" in note for note in found.notes)


@pytest.mark.parametrize("rate", [12.5, 25.0, 33.3, 66.7, 80.0, 100.0, 240.0, 400.0])
@pytest.mark.parametrize("cut", [np.round, np.floor], ids=["rounded", "cut"])
@pytest.mark.parametrize("lost", [0.0, 0.02])
def test_the_rate_is_samples_over_time(
    rate: float, cut: np.ufunc, lost: float, tmp_path: Path
) -> None:
    n = 2000
    kept = np.random.default_rng(4).random(n) >= lost
    t = (cut(np.arange(n) * 1e3 / rate) / 1e3)[kept]
    columns = [[f"{v:.3f}" for v in t], *vectors(n)[kept].T.tolist()]
    path = written(tmp_path / "log.csv", ["time", "acc_x", "acc_y", "acc_z"], columns)
    assert readers.read(path).channels["imu0/acceleration"].rate == pytest.approx(rate, rel=2e-3)
    (channel,) = inspect_recording(readers.blocks(path)).channels
    assert channel.rate_hz == pytest.approx(rate, rel=2e-3)


@pytest.mark.parametrize("rate", [10.0, 20.0, 33.3, 40.0, 50.0, 66.7, 85.7, 100.0])
def test_pages_with_whole_seconds_are_in_one_line(rate: float, tmp_path: Path) -> None:
    begin = datetime(2024, 3, 1, 8, 0, 0, 300_000, tzinfo=UTC)
    samples, pages = [(100, 200, 300)] * 300, 40
    text = gene_file([(100, 200, 300)] * 300, begin.replace(tzinfo=None))
    head = text[: text.index(b"Recorded Data")].replace(b":50.0", f":{rate}".encode())
    starts = [begin.replace(tzinfo=None) + timedelta(seconds=300 * k / rate) for k in range(pages)]
    cut = [start.replace(microsecond=0) for start in starts]
    each = [gene_page(samples, when, number=k, rate=rate) for k, when in enumerate(cut)]
    path = tmp_path / "log.bin"
    path.write_bytes(head + b"".join(each))
    found = readers.read(path)
    assert found.gaps == ()
    assert not [note for note in found.notes if "steps back" in note]
    t = found.channels["imu0/acceleration"].t
    assert t.size == 300 * pages
    np.testing.assert_allclose(np.diff(t), 1.0 / rate, rtol=0.02)


LABELS = ("zyx", "yzx")


@pytest.mark.parametrize("labels", LABELS)
@pytest.mark.parametrize("kind", ["scale", "attribute", "heading", "joined"])
def test_a_label_belongs_to_its_axis(labels: str, kind: str, tmp_path: Path) -> None:
    own = ACC[:, ["xyz".index(letter) for letter in labels]]
    if kind in ("scale", "attribute"):
        path = tmp_path / "log.h5"
        with h5py.File(path, "w") as file:
            file["acceleration"], file["time"] = own, T
            texts = np.array([letter.encode() for letter in labels])
            if kind == "attribute":
                file["acceleration"].attrs["columns"] = texts
            else:
                file["axis"] = texts
                file["axis"].make_scale("axis")
                file["acceleration"].dims[1].attach_scale(file["axis"])
    else:
        path = written(tmp_path / "log.csv", ["time", *labels], [T.tolist(), *own.T.tolist()])
        above = "sensor,acc,acc,acc\n" if kind == "heading" else "sensor,acc,,\n"
        path.write_text(above + path.read_text())
    found = readers.read(path)
    np.testing.assert_array_equal(found.channels["imu0/acceleration"].values, ACC)


def test_labels_that_are_no_axes_are_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["acceleration"], file["time"] = ACC, T
        file["acceleration"].attrs["columns"] = ["north", "east", "down"]
    with pytest.raises(UnreadableInput, match="north, east, down"):
        readers.read(tmp_path / "log.h5")


@pytest.mark.parametrize(
    "units", ["[s],[g],[g],[g],[dps],[dps],[dps]", "s,g,g,g,deg/s,deg/s,deg/s"]
)
def test_a_row_of_units_is_no_heading(units: str, tmp_path: Path) -> None:
    names = ["Time", "Acc_X", "Acc_Y", "Acc_Z", "Gyr_X", "Gyr_Y", "Gyr_Z"]
    columns = [T.tolist(), *(ACC / 9.81).T.tolist(), *GYR.T.tolist()]
    path = written(tmp_path / "log.csv", names, columns)
    first, _, rest = path.read_text().partition("\n")
    path.write_text(f"{first}\n{units}\n{rest}")
    found = readers.read(path)
    gyr = found.channels["imu0/angular_rate"]
    np.testing.assert_allclose(gyr.values, np.deg2rad(GYR), rtol=1e-12)
