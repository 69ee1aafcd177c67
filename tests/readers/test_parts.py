"""Repeats, parts, pairs of files, what may be missing, names of frames."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from imucalib import readers
from imucalib.arrays import Array
from imucalib.errors import UnreadableInput, UsageError
from imucalib.inspection.inspection import Inspection, inspect_recording, problems
from imucalib.readers import blocks, read
from imucalib.readers.fields.joining import join
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.pairing import channel_names, pair
from worlds.bag_logs import ros1_bag, ros2_bag
from worlds.every_format import WRITE
from worlds.mcap_logs import IMU_ROS1, Reading, cdr, packed, readings, ros1, write_log
from worlds.places import DATA, MEASURED, SAMPLES
from worlds.turned import turned

Change = Callable[[Array, Array], None]
RATES = FieldMapping(gyro_unit="rad/s")
WORDS = "repeat the one before to the last digit"
#: Steps of a converter of 16 bits, a quarter of the noise of a sample and less.
ACC_STEP, RATE_STEP = 0.0024, 0.00025


def _changed(change: Change | None = None, steps: float = 1.0) -> tuple[Array, Array, Array]:
    t, acc, rate = turned(8)
    acc, rate = (
        np.round(x / (s * steps)) * s * steps for x, s in ((acc, ACC_STEP), (rate, RATE_STEP))
    )
    if change is not None:
        change(acc, rate)
    return t, acc, rate


def _fill(acc: Array, rate: Array) -> None:
    acc[800:1000] = rate[800:1000] = 0.0


def _hold_shortly(acc: Array, rate: Array) -> None:
    for values in (acc, rate):
        for at in range(100, len(values) - 20, 150):
            values[at : at + 15] = values[at]


def _copy(acc: Array, rate: Array) -> None:
    for values in (acc, rate):
        values[1::2] = values[::2][: len(values[1::2])]


def _dead_zone(acc: Array, rate: Array) -> None:
    rate[np.abs(rate).max(axis=1) < 0.02] = (0.0, 0.0, 0.0)


def _offset_zone(acc: Array, rate: Array) -> None:
    rate[np.abs(rate).max(axis=1) < 0.02] = (0.005, 0.001, -0.002)


def _inspected(path: Path, block: int = 1 << 18) -> Inspection:
    return inspect_recording(readers.blocks(path, RATES, block_samples=block))


@pytest.mark.parametrize("name", WRITE)
@pytest.mark.parametrize("change", [_fill, _hold_shortly, _copy])
def test_every_reader_tells_what_noise_does_not_do(
    name: str, change: Change, tmp_path: Path
) -> None:
    path = WRITE[name](tmp_path, *_changed(change))
    for notes in (readers.read(path, RATES).notes, _inspected(path, 1000).notes):
        told = [note.partition(":")[0] for note in notes if WORDS in note]
        assert sorted(told) == ["imu0/acceleration", "imu0/angular_rate"]
    assert "repeat the one before" in " ".join(problems(_inspected(path)))


@pytest.mark.parametrize("name", WRITE)
@pytest.mark.parametrize("change", [None, _dead_zone, _offset_zone])
def test_no_reader_tells_what_a_sound_sensor_does(
    name: str, change: Change | None, tmp_path: Path
) -> None:
    path = WRITE[name](tmp_path, *_changed(change))
    assert not [note for note in readers.read(path, RATES).notes if WORDS in note]


@pytest.mark.parametrize("zone", [_dead_zone, _offset_zone])
def test_a_gyroscope_with_a_dead_zone_hides_no_rest(zone: Change, tmp_path: Path) -> None:
    found = _inspected(WRITE["hdf5"](tmp_path, *_changed(zone))).still
    assert found is not None
    assert found.n == 9
    assert (found.rate_noise >= RATE_STEP / np.sqrt(12.0) * 0.999).all()


#: Measured recordings that lie with the project, and larger ones that need not be there.
SOUND: dict[Path, FieldMapping] = {
    MEASURED / "ax3.cwa": FieldMapping(),
    MEASURED / "geneactiv.bin": FieldMapping(),
    **{
        MEASURED / f"imu{k}.log.gz": FieldMapping(
            acc=("1", "2", "3"), gyro=("4", "5", "6"), rate=100.0, header=False, acc_unit="m/s2",
            gyro_unit="rad/s",
        )
        for k in (0, 1)
    },
    **{SAMPLES / name: FieldMapping() for name in ("board.h5", "board_part.mcap", "rests.mcap")},
    **{DATA / "mimu4444" / f"exp_{k}.h5": FieldMapping() for k in (1, 2, 4, 5)},
    DATA / "actigraph" / "paat_example_day.csv.gz": FieldMapping(),
    DATA / "actigraph" / "ggir_actigraph_testfile.gt3x": FieldMapping(),
}  # fmt: skip


@pytest.mark.parametrize("path", SOUND, ids=lambda p: p.name)
def test_no_measured_log_is_refused_or_told(path: Path) -> None:
    if not path.exists():
        pytest.skip("needs the shared data")
    for block in readers.blocks(path, SOUND[path]):
        assert not [note for note in block.notes if WORDS in note]
        assert not block.held


RATE = 10.0


def autumn(
    folder: Path, *, lose: range = range(0), back: float = 3600.0
) -> tuple[Path, np.ndarray]:
    """An hour and a half of local time, the clock set back by `back` s after an hour."""
    n = round(5400 * RATE)
    t = 1_603_587_600.0 + np.arange(n) / RATE
    t[round(3600 * RATE) :] -= back
    rng = np.random.default_rng(1)
    values = np.array([0.0, 0.0, 1.0]) + rng.normal(scale=0.003, size=(n, 3)).round(5)
    rows = [k for k in range(n) if k not in lose]
    path = folder / "a.csv"
    path.write_text(
        "unix [s],x,y,z [g]\n".replace("x,y,z [g]", "x [g],y [g],z [g]")
        + "".join(
            f"{t[k]:.1f},{values[k, 0]:.5f},{values[k, 1]:.5f},{values[k, 2]:.5f}\n" for k in rows
        )
    )
    return path, values[rows] * 9.80665


def test_the_end_of_summer_time_makes_two_parts(tmp_path: Path) -> None:
    path, values = autumn(tmp_path)
    found = read(path)
    acc = found.channels["imu0/acceleration"]
    np.testing.assert_allclose(acc.values, values, atol=1e-9)
    np.testing.assert_allclose(acc.t, np.arange(acc.t.size) / RATE, atol=1e-6)
    (gap,) = found.gaps
    assert (gap.start, gap.stop) == (pytest.approx(3599.9), pytest.approx(3600.0))
    assert "set back by 3599.9 s" in gap.reason
    assert sum("a part of its own" in note for note in found.notes) == 1


@pytest.mark.parametrize("row", [0, 1, 2, 3, 500, 1998, 1999])
@pytest.mark.parametrize("off", [-90.0, 90.0, 9e6])
def test_one_wrong_stamp_sets_no_clock(row: int, off: float, tmp_path: Path) -> None:
    t = np.arange(2000) / 100.0 + 100.0
    wrong = t.copy()
    wrong[row] += off
    values = np.tile([[0.0, 0.0, 1.0]], (2000, 1)) + np.arange(6000).reshape(-1, 3) % 7 / 1000
    path = tmp_path / "a.csv"
    rows = zip(wrong, *values.T, strict=True)
    path.write_text(
        "t [s],x [g],y [g],z [g]\n"
        + "".join(f"{s:.2f},{x:.3f},{y:.3f},{z:.3f}\n" for s, x, y, z in rows)
    )
    for found in (read(path), join(blocks(path, block_samples=200), "")):
        acc = found.channels["imu0/acceleration"]
        same = np.delete(np.arange(acc.t.size), row)
        np.testing.assert_allclose(acc.t[same], t[same], atol=1e-9)
        assert not any("part of its own" in note for note in found.notes)


START = 1_700_000_000.0
UNITS = FieldMapping(gyro_unit="rad/s")


def put(path: Path, values: np.ndarray, t: np.ndarray, heading: str = "time (s),x,y,z") -> Path:
    lines = [f"{s:.4f},{x!r},{y!r},{z!r}" for s, (x, y, z) in zip(t, values.tolist(), strict=True)]
    path.write_text(heading + "\n" + "\n".join(lines) + "\n")
    return path


def phone(
    folder: Path, start: float, later: float = 0.3
) -> tuple[list[Path], np.ndarray, np.ndarray]:
    """Their files, the forces at 100 Hz and the rates at 80 Hz that begin later."""
    rng = np.random.default_rng(2)
    acc = np.array([0.2, -0.1, 9.75]) + rng.normal(scale=0.02, size=(900, 3))
    gyro = rng.normal(scale=0.2, size=(700, 3))
    one = put(folder / "Accelerometer.csv", acc, start + np.arange(900) / 100.0)
    two = put(folder / "Gyroscope.csv", gyro, start + later + np.arange(700) / 80.0)
    return [one, two], acc, gyro


@pytest.mark.parametrize("start", [START, 5000.0])
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("later", [0.3, -0.3])
def test_both_files_keep_their_moments(
    start: float, turned: bool, later: float, tmp_path: Path
) -> None:
    paths, acc, gyro = phone(tmp_path, start, later)
    found = readers.read_together(paths[::-1] if turned else paths, UNITS)
    force, turn = (found.channels[f"imu0/{q}"] for q in ("acceleration", "angular_rate"))
    np.testing.assert_array_equal(force.values, acc)
    np.testing.assert_array_equal(turn.values, gyro)
    assert turn.t[0] - force.t[0] == pytest.approx(later, abs=1e-6)
    if start == START:
        assert found.start_ns == pytest.approx((start + min(0.0, later)) * 1e9, abs=1e3)
    assert any("by the name of the file" in note for note in found.notes)


def test_what_does_not_belong_together_is_refused(tmp_path: Path) -> None:
    paths, acc, _ = phone(tmp_path, START)
    again = put(tmp_path / "again.csv", acc, START + np.arange(900) / 100.0)
    with pytest.raises(UsageError, match=r"acceleration is in Accelerometer.csv and in again.csv"):
        readers.read_together([paths[0], again])
    (tmp_path / "late").mkdir()
    late, _, _ = phone(tmp_path / "late", START + 3600.0)
    with pytest.raises(UsageError, match="clocks do not overlap"):
        readers.read_together([paths[0], late[1]])
    (tmp_path / "bare").mkdir()
    bare, _, _ = phone(tmp_path / "bare", 10.0)
    with pytest.raises(UsageError, match="has no date"):
        readers.read_together([paths[0], bare[1]])


ROWS = 300
HEADING = "time (s),acc_x (g),acc_y (g),acc_z (g)"


def acc() -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.round(np.array([0.03, -0.04, 0.99]) + rng.normal(scale=0.003, size=(ROWS, 3)), 5)


def table(
    path: Path, heading: str = HEADING, more: str = "", end: str = "\n", above: str = ""
) -> Path:
    lines = [f"{0.01 * k:.2f},{x:.5f},{y:.5f},{z:.5f}{more}" for k, (x, y, z) in enumerate(acc())]
    path.write_text(above + "\n".join([heading, *lines]) + end)
    return path


def count(found: readers.Recording) -> int:
    return found.channels["imu0/acceleration"].t.size


def test_a_table_does_without_a_thermometer_and_gyroscope_of_unknown_units(tmp_path: Path) -> None:
    more = ",gyr_x (furlong/s),gyr_y (furlong/s),gyr_z (furlong/s),temperature (Rankine)"
    path = table(tmp_path / "a.csv", HEADING + more, ",0.1,0.2,0.3,531.7")
    found = readers.read(path)
    assert set(found.channels) == {"imu0/acceleration"}
    assert any("temperature left out" in n and "'Rankine'" in n for n in found.notes)
    assert any("angular_rate left out" in n and "--gyro-unit" in n for n in found.notes)
    named = readers.read(path, FieldMapping(gyro_unit="deg/s", temperature_unit="degF"))
    assert len(named.channels) == 3
    with pytest.raises(UsageError, match="--temperature-unit"):
        readers.read(path, FieldMapping(temperature_unit="furlong"))
    alone = table(tmp_path / "b.csv", HEADING.replace("acc", "gyr").replace("(g)", "(furlong/s)"))
    with pytest.raises(UnreadableInput, match=r"furlong.*--gyro-unit"):
        readers.read(alone)


def test_a_last_line_that_lacks_only_its_end_is_a_row(tmp_path: Path) -> None:
    whole = readers.read(table(tmp_path / "a.csv"))
    ended = readers.read(table(tmp_path / "b.csv", end=""))
    assert ended.notes == whole.notes
    np.testing.assert_array_equal(
        ended.channels["imu0/acceleration"].values, whole.channels["imu0/acceleration"].values
    )
    cut = tmp_path / "c.csv"
    cut.write_bytes((tmp_path / "b.csv").read_bytes()[:-1])
    found = readers.read(cut)
    assert count(found) == ROWS - 1
    assert any("may be cut" in note for note in found.notes)


#: Topics whose words do not tell one from another.
TOPICS = ("/imu/1/data", "/imu/2/data")
Topics = dict[str, list[Reading]]


def _cdr(path: Path, topics: Topics) -> Path:
    return write_log(path / "a.mcap", {t: packed(rows, cdr) for t, rows in topics.items()})


def _ros1(path: Path, topics: Topics) -> Path:
    schema = ("sensor_msgs/Imu", "ros1msg", IMU_ROS1.encode())
    rows = {t: packed(rows, ros1) for t, rows in topics.items()}
    return write_log(path / "a.mcap", rows, schema=schema, encoding="ros1")


def _json(path: Path, topics: Topics) -> Path:
    def pack(r: Reading) -> bytes:
        stamp = {"sec": r.ns // 10**9, "nanosec": r.ns % 10**9}
        header = {"stamp": stamp, "frame_id": r.frame}
        return json.dumps({"header": header, "acc": list(r.acc), "gyro": list(r.gyro)}).encode()

    rows = {t: packed(rows, pack) for t, rows in topics.items()}
    schema = ("Imu", "jsonschema", b"{}")
    return write_log(path / "a.mcap", rows, schema=schema, encoding="json")


FRAMES_WRITE: dict[str, Callable[[Path, Topics], Path]] = {
    "mcap cdr": _cdr,
    "mcap ros1": _ros1,
    "mcap json": _json,
    "ros1 bag": lambda path, topics: ros1_bag(path / "a.bag", topics),
    "ros2 bag": lambda path, topics: ros2_bag(path / "a", topics),
}


def _logged(frames: tuple[str, str]) -> Topics:
    return {t: readings(400, k, 200.0, frames[k]) for k, t in enumerate(TOPICS)}


@pytest.mark.parametrize("name", FRAMES_WRITE)
def test_a_frame_is_paired_as_a_topic_is(name: str, tmp_path: Path) -> None:
    """Names in another order than the topics', so that pairing in order would be wrong."""
    path = FRAMES_WRITE[name](tmp_path, _logged(("body/right_link", "body/left_link")))
    for recording in (readers.read(path), join(readers.blocks(path, block_samples=100), "")):
        for wanted in ([("left_link",), ("right_link",)], [("body/left_link",), ("right_link",)]):
            assert pair(wanted, recording, "the board").partner == {"imu0": 1, "imu1": 0}
        # What a calibration keeps is the topic: only that is one in every file.
        assert channel_names(recording) == dict(zip(("imu0", "imu1"), TOPICS, strict=True))
