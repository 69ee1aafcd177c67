"""Names out of files that were made to steer a terminal or a spreadsheet."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from imucalib import readers, writers
from imucalib.recording.recording import Channel, Recording
from worlds.mcap_logs import START, cdr, packed, readings, write_log

N = 2000
EVIL = "\x1b]0;owned\x07\x1b[2J\u009b31m\u202e"
STEERING = ["\x1b", "\x07", "\u009b", "\u202e", "\x7f"]


def values() -> np.ndarray:
    return np.array([0, 0, 9.8]) + np.random.default_rng(0).normal(0, 0.02, (N, 3))


def mcap(folder: Path, *, imu: bool = True) -> Path:
    topics = {f"/imu{EVIL}/data": packed(readings(N), cdr)}
    if imu:
        return write_log(folder / "a.mcap", topics)
    schema = ("std_msgs/msg/String", "ros2msg", b"string data")
    return write_log(folder / "a.mcap", {f"/{EVIL}": [(START, bytes(12))]}, schema=schema)


def text(folder: Path) -> Path:
    head = ",".join(["time [s]", *(f"acc{EVIL} {a} [g]" for a in "xyz"), f"other{EVIL}"])
    rows = [f"{k / 100:.2f},0.001,0.002,{0.99 + 0.01 * (k % 3):.3f},1" for k in range(N)]
    (folder / "a.csv").write_text("\n".join([head, *rows]) + "\n")
    return folder / "a.csv"


def hdf5(folder: Path, unit: str = f"furlong{EVIL}") -> Path:
    with h5py.File(folder / "a.h5", "w") as file:
        file[f"s{EVIL}/acc"] = values()
        file[f"s{EVIL}/acc"].attrs["units"] = unit
        file[f"s{EVIL}"].attrs["rate"] = 100.0
    return folder / "a.h5"


def run(*arguments: object) -> str:
    command = [sys.executable, "-m", "imucalib", *map(str, arguments)]
    found = subprocess.run(command, check=False, capture_output=True, timeout=120)
    return (found.stdout + found.stderr).decode("utf-8")


@pytest.mark.slow
@pytest.mark.parametrize(
    "make",
    [
        mcap,
        lambda folder: mcap(folder, imu=False),
        text,
        hdf5,
        lambda folder: hdf5(folder, "m/s2"),
    ],
    ids=["mcap", "no imu", "csv", "hdf5 unit", "hdf5"],
)
def test_no_name_steers_the_terminal(make: object, tmp_path: Path) -> None:
    path = make(tmp_path)  # type: ignore[operator]
    for arguments in (
        ("inspect", path),
        ("inspect", path, "--json"),
        ("inspect", path, "--acc", "none"),
        ("convert", path, tmp_path / "b.csv"),
        ("convert", path, tmp_path / "b.h5", "--json"),
    ):
        told = run(*arguments)
        assert told
        assert not [c for c in STEERING if c in told], (arguments, told)


@pytest.mark.slow
def test_json_keeps_the_name_itself(tmp_path: Path) -> None:
    told = json.loads(run("inspect", hdf5(tmp_path, "m/s2"), "--json", "--quiet"))
    assert EVIL in told["channels"][0]["name"]


@pytest.mark.parametrize(
    "name", ["=1+1", "+1", "-1", "@sum", "a,b", 'a"b', " =1", "a\n=1", "a\r=1"]
)
def test_a_written_table_holds_no_formula(name: str, tmp_path: Path) -> None:
    channel = Channel(np.arange(N) / 100.0, values(), "m/s2", "acceleration", name, 100.0)
    path = tmp_path / "a.csv"
    writers.write(Recording({f"{name}/acceleration": channel}, "", "", ""), path)
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert len(rows[1]) == 4
    assert len(rows) == N + 2
    assert not [c for row in rows[:2] for c in row if c.lstrip()[:1] in tuple("=+-@")]
    (back,) = readers.read(path).channels.values()
    np.testing.assert_array_equal(back.values, channel.values)
