"""`imucal inspect` as a user meets it: what it shows, what it saves, what it says when wrong."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import Result

from imucalib import readers, writers
from imucalib.errors import ImucalError, UnreadableInput
from imucalib.recording.mapping import load_mapping
from worlds.bag_logs import ros1_bag, ros2_bag
from worlds.command import run
from worlds.mcap_logs import START, Reading, cdr, packed, write_log

RATE, PER_SIDE = 100.0, 500
SIDES = ((0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 0, -1), (0, -1, 0), (-1, 0, 0))


def tumble(seed: int = 0) -> list[Reading]:
    """Six sides, still on each, turned by hand in between."""
    rng = np.random.default_rng(seed)
    rows = []
    for k, side in enumerate(SIDES):
        for i in range(PER_SIDE):
            moving = i > 0.8 * PER_SIDE
            a = 9.81 * np.array(side) + rng.normal(0, 2.0 if moving else 0.02, 3)
            w = rng.normal(0, 0.5 if moving else 0.003, 3)
            at = START + round((k * PER_SIDE + i) * 1e9 / RATE)
            rows.append(Reading(at, tuple(a.tolist()), tuple(w.tolist())))
    return rows


ROWS = tumble()


def mcap(path: Path) -> Path:
    return write_log(path / "one.mcap", {"/imu/data": packed(ROWS, cdr)})


def mcap_with_four(path: Path) -> Path:
    topics = {f"/imu{k}/data": packed(tumble(k), cdr) for k in range(4)}
    return write_log(path / "four.mcap", topics)


def damaged_mcap(path: Path) -> Path:
    file = mcap(path)
    data = bytearray(file.read_bytes())
    data[len(data) // 3] ^= 4
    file.write_bytes(data[: int(0.8 * len(data))])
    return file


def json_mcap(path: Path) -> Path:
    trees = [
        (r.ns, json.dumps({"t": r.ns, "body": {"sf": list(r.acc), "rot": list(r.gyro)}}).encode())
        for r in ROWS
    ]
    states = [(r.ns, b'{"mode": 1}') for r in ROWS[::100]]
    logs = {"/stm/readings": trees, "/stm/state": states}
    schema = ("my.Sample", "jsonschema", b"{}")
    return write_log(path / "json.mcap", logs, schema=schema, encoding="json")


def csv(path: Path) -> Path:
    lines = ["t [s];ax [g];ay [g];az [g]"]
    for r in ROWS:
        cells = [(r.ns - START) * 1e-9, *(a / 9.80665 for a in r.acc)]
        lines.append(";".join(f"{c:.6f}".replace(".", ",") for c in cells))
    file = path / "a.csv"
    file.write_text("\n".join(lines) + "\n")
    return file


def nameless_csv(path: Path) -> Path:
    rows = [f"{i},{r.acc[0]:.3f},{r.acc[1]:.3f},{r.acc[2]:.3f},7" for i, r in enumerate(ROWS)]
    file = path / "bare.csv"
    file.write_text("n,ch1,ch2,ch3,flag\n" + "\n".join(rows) + "\n")
    return file


def hdf5(path: Path) -> Path:
    writers.write(readers.read(mcap(path)), path / "own.h5")
    return path / "own.h5"


def foreign_hdf5(path: Path) -> Path:
    with h5py.File(path / "lab.h5", "w") as file:
        file["run/samples"] = np.array([r.acc for r in ROWS])
        file["run/stamp"] = np.array([(r.ns - START) * 1e-9 for r in ROWS])
        file["meta"] = np.arange(7)
    return path / "lab.h5"


def ros1(path: Path) -> Path:
    return ros1_bag(path / "a.bag", {"/imu": ROWS})


def ros2(path: Path) -> Path:
    return ros2_bag(path / "bag", {"/imu": ROWS})


FILES = [mcap, mcap_with_four, damaged_mcap, csv, hdf5, ros1, ros2]
Made = Callable[[Path], Path]


def inspect(*arguments: object) -> Result:
    return run("inspect", *arguments)


@pytest.mark.parametrize("made", FILES)
def test_a_saved_mapping_gives_the_same_reading(made: Made, tmp_path: Path) -> None:
    file, mapping = made(tmp_path), tmp_path / "m.yaml"
    one, two = (
        json.loads(inspect(file, "--json", name, mapping).stdout)
        for name in ("--save-mapping", "--mapping")
    )
    assert one["mapping"] == two["mapping"]
    assert one["channels"] == two["channels"]
    a, b = readers.read(file), readers.read(file, load_mapping(mapping))
    assert a.channels.keys() == b.channels.keys()
    for name, channel in a.channels.items():
        np.testing.assert_array_equal(channel.values, b.channels[name].values)
        np.testing.assert_array_equal(channel.t, b.channels[name].t)
    assert (a.start_ns, a.gaps) == (b.start_ns, b.gaps)


@pytest.mark.parametrize(
    ("made", "options"),
    [
        (json_mcap, ("--acc", "/stm/readings:body.sf", "--gyro", "/stm/readings:body.rot",
                     "--gyro-unit", "rad/s")),
        (nameless_csv, ("--acc", "ch1,ch2,ch3", "--rate", "100")),
        (foreign_hdf5, ("--acc", "/run/samples")),
    ],
)  # fmt: skip
def test_an_unknown_layout_lists_its_fields_and_the_option_that_reads_it(
    made: Made, options: tuple[str, ...], tmp_path: Path
) -> None:
    file = made(tmp_path)
    error = inspect(file).exception
    assert isinstance(error, ImucalError)
    assert f"--acc {options[1]}" in str(error)
    assert "median norm 9.8" in str(error)
    result = inspect(file, *options)
    assert result.exit_code == 0, result.exception
    assert "6 still segments; nothing is wrong" in result.stdout


@pytest.mark.parametrize(
    ("made", "options", "match"),
    [
        (mcap, ("--acc", "/nope"), r"'/nope' is not a topic[^$]*/imu/data: 3000 x"),
        (ros1, ("--acc", "/nope"), r"'/nope' is not a topic[^$]*/imu: 3000 x"),
        (mcap, ("--acc", "/imu/data:nope"), "no 3-vector 'nope'.*linear_acceleration"),
        (csv, ("--acc", "a,b,c"), "no column 'a'.*ax"),
        (csv, ("--unit", "furlong"), "--unit: unknown unit 'furlong'.*m/s2"),
        (csv, ("--preset", "nokia"), "unknown preset 'nokia'.*euroc"),
        (csv, ("--axis-map", "x,y"), "x, y and z once each"),
        (csv, ("--time-unit", "days"), "unknown time unit 'days'"),
        (csv, ("--rate", "0"), "not a positive number"),
        (foreign_hdf5, ("--acc", "/nope"), "no dataset '/nope'.*/run/samples"),
    ],
)
def test_a_wrong_mapping_is_named_with_what_there_is(
    made: Made, options: tuple[str, ...], match: str, tmp_path: Path
) -> None:
    error = inspect(made(tmp_path), *options).exception
    assert isinstance(error, ImucalError)
    assert error.exit_code in (2, 3)
    assert re.search(match, str(error), re.DOTALL), str(error)


@pytest.mark.parametrize("make", [mcap, csv, hdf5])
@pytest.mark.parametrize("command", ["inspect", "convert"])
def test_a_unit_that_the_rests_contradict_is_refused(
    make: Callable[[Path], Path], command: str, tmp_path: Path
) -> None:
    target = tmp_path / "out.h5"
    arguments = [command, make(tmp_path), *([target] if command == "convert" else [])]
    for unit in ("mg", "g"):
        if unit == "g" and make is csv:
            continue  # that one is in g
        result = run(*arguments, "--unit", unit)
        assert isinstance(result.exception, UnreadableInput)
        assert f"when the unit is {unit}, as --unit states" in str(result.exception)
        assert not target.exists()


def test_every_candidate_for_a_rest_is_listed_with_its_reason(tmp_path: Path) -> None:
    """Twelve rests in random attitudes; at the end a turn of two mg/s for 30 s."""
    rng, parts = np.random.default_rng(0), []
    for _ in range(12):
        direction = rng.normal(size=3)
        direction *= 9.80665 / np.linalg.norm(direction)
        parts += [direction + rng.normal(0, 6.0, (250, 3)), np.tile(direction, (300, 1))]
    across = np.cross(direction, [0.3, 0.5, 0.8])
    parts.append(direction + rng.normal(0, 6.0, (250, 3)))
    parts.append(direction + np.arange(3000)[:, None] / RATE * 2e-3 * across)
    values = np.concatenate(parts)
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["accelerometer"] = values + rng.normal(0, 0.02, values.shape)
        file["accelerometer"].attrs["unit"] = "m/s^2"
        file["time"] = np.arange(len(values)) / RATE
        file["time"].attrs["unit"] = "s"
    rests = json.loads(inspect(tmp_path / "log.h5", "--rests", "--json", "-q").stdout)["rests"]
    assert sum(bool(r["rest"]) for r in rests) == 12
    (turn,) = (r for r in rests if r["reason"] == "turning")
    assert turn["length_s"] == pytest.approx(30.0, abs=4.0)
    assert turn["noise"] == pytest.approx(0.02, rel=0.2)
    shown = inspect(tmp_path / "log.h5", "--rests").stdout
    assert "12 rests" in shown
    assert "turning" in shown
    assert "Candidates for rests" not in inspect(tmp_path / "log.h5").stdout
