"""A recording of several sensors: every command that reads one names the sensor that it takes, or
says which there are."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from imucalib.readers import read
from options.tree import commands, options_of
from worlds.command import run
from worlds.turned_imu import G0
from worlds.two_sensors import NAMES, logs, two_sensors

#: What reads a recording, and how it is called beside the recording and its output.
READING = sorted(name for name, command in commands().items() if "--acc" in options_of(command))
CALLS: dict[str, tuple[str, ...]] = {
    "actigraph": ("{two}", "--no-loop"),
    "apply": ("{calibration}", "{two}", "-o", "{out}/corrected.csv"),
    "array": ("{two}", "--board", "mimu4444_corners", "--no-loop"),
    "check": ("{calibration}", "{two}"),
    "convert": ("{two}", "{out}/two.h5"),
    "fleet": ("{two}", "{again}", "--reference", "norm"),
    "imu": ("{two}", "--no-loop"),
    "inspect": ("{two}",),
    "lab": ("{two}", "--reference", "norm", "--no-loop"),
    "noise": ("{two}",),
}
#: What shows all of them, and asks for no choice.
ALL = ("convert", "inspect", "noise")
#: What says it of each of several recordings.
GATHERS = ("fleet",)


@pytest.fixture(scope="module", params=(".csv", ".mcap"))
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("two")
    two_sensors(made / f"two{request.param}")
    two_sensors(made / f"again{request.param}")
    log = logs(two_sensors(made / f"one{request.param}", ("one",)))[0]
    log.write(made / "one.csv")
    done = run("imu", made / "one.csv", "--no-loop", "-q", "-o", made / "of_one")
    assert done.return_value == 0, done.exception
    return made


def typed(name: str, folder: Path, out: Path) -> list[str]:
    two, again = sorted(folder.glob("two.*"))[0], sorted(folder.glob("again.*"))[0]
    places = {"two": two, "again": again, "out": out,
              "calibration": folder / "of_one" / "calibration.yaml"}  # fmt: skip
    return [name, *(word.format(**places) for word in CALLS[name])]


def test_each_of_them_has_the_option_and_no_other() -> None:
    assert set(CALLS) == set(READING)
    for name, command in commands().items():
        assert ("--sensor" in options_of(command)) == (name in READING)
        assert not {"--triad", "--topic", "--channel"} & set(options_of(command))


@pytest.mark.parametrize("name", READING)
def test_both_are_named_and_the_command_that_is_advised_runs(
    name: str, folder: Path, tmp_path: Path
) -> None:
    done = run(*typed(name, folder, tmp_path))
    said = done.output + str(done.exception or "")
    assert all(sensor in said for sensor in NAMES)
    assert (done.return_value == 0) == (name in ALL), said
    if name not in (*ALL, *GATHERS):
        assert done.return_value == 2 or name == "array"
    if "for example: " in said:
        line = str(done.exception).rpartition("for example: ")[2]
        words = shlex.split(line)
        assert words[:2] == ["imucal", name]
        again = run(*words[1:])  # of a calibration by another chip its gravity says so
        assert again.return_value in (0, 1, 4, 5) or "--same-device" in str(again.exception)


@pytest.mark.slow
def test_of_the_sensor_that_is_named_are_the_numbers(folder: Path, tmp_path: Path) -> None:
    two = next(folder.glob("two.*"))
    found = []
    for name, log in zip(NAMES, logs(two_sensors(tmp_path / two.name)), strict=True):
        one = log.write(tmp_path / f"{name}.csv")
        alone = run("imu", one, "--no-loop", "--json")
        chosen = run("imu", two, "--sensor", name, "--no-loop", "--json")
        assert chosen.return_value == alone.return_value
        values, sd = (
            [[p[key] for p in json.loads(done.stdout)["parameters"]] for done in (alone, chosen)]
            for key in ("value", "sd")
        )
        np.testing.assert_array_less(np.abs(np.subtract(*values)), 0.02 * np.array(sd[0]))
        found.append(values[1])
    assert not np.allclose(*found, rtol=0.1)


@pytest.mark.slow
def test_all_gives_each_a_calibration_of_its_own(folder: Path, tmp_path: Path) -> None:
    two = next(folder.glob("two.*"))
    done = run("imu", two, "--sensor", "all", "--no-loop", "--json", "-o", tmp_path / "out")
    assert done.return_value == 0, done.exception
    reports = json.loads(done.stdout)["logs"]
    for report in reports:
        name = report["provenance"]["mapping"]["sensor"]
        text = (tmp_path / "out" / name / "calibration.yaml").read_text(encoding="utf-8")
        content = YAML(typ="safe", pure=True).load(text)
        assert [p["value"] for p in content["parameters"]] == [
            p["value"] for p in report["parameters"]
        ]
        alone = run("imu", two, "--sensor", name, "--no-loop", "--json")
        assert json.loads(alone.stdout)["parameters"] == report["parameters"]


def test_what_is_not_chosen_stays_as_it_was(folder: Path, tmp_path: Path) -> None:
    words = typed("apply", folder, tmp_path)
    assert run(*words, "--sensor", "aux", "--same-device").return_value == 0
    before, after = read(next(folder.glob("two.*"))), read(tmp_path / "corrected.csv")
    for name, channel in before.channels.items():
        same = np.allclose(channel.values, after.channels[name].values, atol=1e-7)
        assert same == (channel.triad == "main"), name
    assert (
        abs(G0 - np.median(np.linalg.norm(after.channels["main/acceleration"].values, axis=1))) < 1
    )


def test_a_name_that_is_none_is_refused_with_those_there_are(folder: Path, tmp_path: Path) -> None:
    for name in ("convert", "imu", "inspect", "lab"):
        done = run(*typed(name, folder, tmp_path), "--sensor", "third")
        assert done.return_value == 2
        assert all(sensor in str(done.exception) for sensor in NAMES)


@pytest.mark.slow
def test_the_name_is_in_all_that_is_made_of_it(folder: Path, tmp_path: Path) -> None:
    two, out = next(folder.glob("two.*")), tmp_path / "out"
    done = run("imu", two, "--sensor", "aux", "--no-loop", "--json", "-o", out)
    report = json.loads(done.stdout)
    text = (out / "calibration.yaml").read_text(encoding="utf-8")
    for block in (report, YAML(typ="safe", pure=True).load(text)):
        sensor = block["sensor"]
        assert (sensor["name"], sensor["unit"]) == ("aux", "m/s2")
        assert sensor["rate_hz"] == pytest.approx(100.0)
        assert sensor["to_m_per_s2"] == [1.0]
    assert "aux" in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["ax3.cwa", "geneactiv.bin"])
def test_a_device_keeps_its_number_through_conversions(name: str, tmp_path: Path) -> None:
    first = read(Path(__file__).parents[1] / "measured" / name)
    assert first.device
    assert first.serial
    for suffix in (".csv", ".h5"):
        path = tmp_path / f"again{suffix}"
        assert run("convert", first.path, path, "-q").return_value == 0
        assert read(path).serial == first.serial


def recorded(folder: Path, kind: str = "two") -> Path:
    return next(folder.glob(f"{kind}.*"))


@pytest.fixture(scope="module")
def of_aux(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("aux")
    call = ("imu", recorded(folder), "--sensor", "aux", "--no-loop", "-q", "-o", out)
    assert run(*call).return_value == 0
    return out / "calibration.yaml"


@pytest.mark.slow
def test_a_calibration_finds_its_own_sensor_and_refuses_another(
    folder: Path, of_aux: Path, tmp_path: Path
) -> None:
    two, out = recorded(folder), tmp_path / "corrected.h5"
    assert run("apply", of_aux, two, "-o", out, "-q").return_value == 0
    before, after = read(two), read(out)
    for name, channel in before.channels.items():
        same = np.allclose(channel.values, after.channels[name].values, atol=1e-7)
        assert same == (channel.triad == "main"), name
    assert run("check", of_aux, two, "-q").return_value in (0, 5)
    for call in (
        ("apply", of_aux, two, "-o", tmp_path / "main.h5", "--sensor", "main"),
        ("check", of_aux, two, "--sensor", "main"),
    ):
        done = run(*call)
        assert done.return_value == 2
        assert all(sensor in str(done.exception) for sensor in NAMES)
        words = shlex.split(str(done.exception).rpartition("for example: ")[2])
        assert run(*words[1:]).return_value in (0, 1)
    assert not np.allclose(
        read(tmp_path / "main.h5").channels["main/acceleration"].values,
        before.channels["main/acceleration"].values,
    )


def test_where_names_are_silent_gravity_decides(folder: Path, tmp_path: Path) -> None:
    """The calibration of one chip, from a table without names, on that of another."""
    log = logs(two_sensors(tmp_path / "pair.csv"))[1].write(tmp_path / "other.csv")
    own, out = folder / "of_one" / "calibration.yaml", tmp_path / "c.csv"
    done = run("apply", own, folder / "one.csv", "-o", out, "--json")
    assert done.return_value == 0
    assert any("mg as read" in note for note in json.loads(done.stdout)["notes"])
    done = run("apply", own, log, "-o", tmp_path / "wrong.csv")
    assert done.return_value == 2
    assert "another sensor" in str(done.exception)
    assert not (tmp_path / "wrong.csv").exists()
    assert run("apply", own, log, "-o", tmp_path / "wrong.csv", "--same-device").return_value == 0
