"""`imucal imu` on logs whose truth is known, measured logs, logs that are no good; its plans."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imucalib.calibration.file import read as read_calibration
from imucalib.calibration.gyroscope import gyroscope_of
from imucalib.calibrators.imu.plan import hand_plan, of_turn
from imucalib.readers import read
from imucalib.recording.recording import Channel, Recording
from imucalib.writers import write
from worlds.command import run
from worlds.places import MEASURED
from worlds.recordings import recording_of
from worlds.targets import by_kalibr, by_opencv
from worlds.turned_imu import G0, Log, chip, plan, turned

MPU = ("--rate", "100", "--acc", "1,2,3", "--gyro", "4,5,6", "--unit", "m/s2", "--gyro-unit",
       "rad/s")  # fmt: skip


def report(*arguments: object) -> dict:  # type: ignore[type-arg]
    result = run("imu", *arguments, "--json", "-q")
    assert result.exception is None, result.exception
    return json.loads(result.stdout)  # type: ignore[no-any-return]


def made(path: Path, seed: int = 1, **options: object) -> tuple[Log, Path]:
    rng = np.random.default_rng(seed)
    log = turned(chip(rng), rng, **options)  # type: ignore[arg-type]
    return log, log.write(path)


@pytest.mark.parametrize(
    ("name", "mark"),
    [
        ("imu0.log.gz", 0.10),
        pytest.param("imu1.log.gz", 0.11, marks=pytest.mark.slow),
    ],
)
def test_measured_logs_turned_by_hand(name: str, mark: float) -> None:
    content = report(MEASURED / name, *MPU)
    error = content["loop"]["errors"][0]
    assert error["unit"] == "deg"
    assert error["held_out"]["final"] < mark < 0.3 < error["held_out"]["raw"]
    assert not any(step["certain"] for step in content["loop"]["steps"])
    assert content["exit_code"] == 0


@pytest.mark.slow
def test_sensitivity_to_force_is_named_and_undone(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    planted = np.radians(0.15) * rng.normal(size=(3, 3))
    log = turned(chip(rng, by_force=planted), rng, rests=20)
    path = log.write(tmp_path / "turns.csv")
    result = run("imu", path, "-o", tmp_path / "out", "-q", "--json")
    content = json.loads(result.stdout)
    step = content["loop"]["steps"][0]
    assert (step["effect"], step["certain"]) == ("gyro_g_sensitivity", True)
    held = content["loop"]["errors"][0]["held_out"]
    assert held["final"] < 0.5 * held["base"]
    target = tmp_path / "corrected.h5"
    assert (
        run("apply", tmp_path / "out/calibration.yaml", path, "-o", target, "-q").exception is None
    )
    corrected, before = read(target), read(path)
    name = "imu0/angular_rate"
    # What turns gravity is the truth's own: du/dt = -ω x u, where it is fast.
    slope = np.gradient(log.up, log.t, axis=0)
    off = [
        np.sqrt(np.mean((slope + np.cross(r.channels[name].values, log.up)) ** 2))
        for r in (before, corrected)
    ]
    assert off[1] < 0.2 * off[0]


@pytest.mark.slow
@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 4, 5])
def test_gains_know_of_laws_that_the_turns_cannot_name(seed: int, tmp_path: Path) -> None:
    """A square that twelve rests cannot tell from other laws moves a gain by three of the standard
    deviations that the likeliest law alone would leave it."""
    rng = np.random.default_rng(seed)
    bent = chip(rng, square=np.array([0.0, 0.002, 0.0]), per_angle=5e-4)
    content = report(turned(bent, rng, rests=12).write(tmp_path / "log.csv"))
    (gain,) = (p for p in content["parameters"] if p["name"] == "gyro_gain_yy")
    assert abs(gain["value"] - np.linalg.inv(bent.M)[1, 1]) < 2.5 * gain["sd"]


def test_exports_say_what_the_sensor_reads(tmp_path: Path) -> None:
    """Kalibr's and OpenVINS' equations, by hand, against the calibration's own inverse."""
    rng = np.random.default_rng(4)
    log = turned(chip(rng, by_force=np.radians(0.15) * rng.normal(size=(3, 3))), rng, rests=20)
    path, out = log.write(tmp_path / "turns.csv"), tmp_path / "out"
    run("imu", path, "-o", out, "-q")
    gyro = gyroscope_of(read_calibration(out / "calibration.yaml"))
    assert gyro is not None
    assert gyro.by_force.any()
    rate, force = rng.normal(size=3), 9.8 * rng.normal(size=3)
    reading = np.linalg.inv(gyro.gain) @ rate + gyro.by_force @ force + gyro.bias
    np.testing.assert_allclose(gyro.rate(reading[None], force[None])[0], rate, atol=1e-12)
    walks = ("--random-walk", "1e-3,1e-5", "-q", "--force")
    text = run("export", out / "calibration.yaml", "--to", "kalibr", *walks).stdout
    block = by_kalibr(text)
    g, turn = block["gyroscopes"], np.array(block["gyroscopes"]["C_gyro_i"])
    own = np.array(g["M"]) @ turn @ rate + np.array(g["A"]) @ turn @ force
    np.testing.assert_allclose(own, reading - gyro.bias, atol=1e-9)
    np.testing.assert_allclose(np.triu(g["M"], 1), 0.0, atol=1e-12)
    block = by_opencv(run("export", out / "calibration.yaml", "--to", "openvins", *walks).stdout)
    turn = np.array(block["R_IMUtoGYRO"])
    back = (
        turn.T @ np.linalg.inv(block["Tw"]) @ (reading - gyro.bias - np.array(block["Tg"]) @ force)
    )
    np.testing.assert_allclose(back, rate, atol=1e-9)


@pytest.mark.parametrize("late", [0.005, pytest.param(0.0, marks=pytest.mark.slow)])
def test_a_late_gyroscope_shows_in_the_moving_accelerometer(late: float, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    log = turned(chip(rng, late=late), rng)
    own = report(log.write(tmp_path / "late.csv"), "--no-loop")["imu"]["gyroscope_late_s"]
    assert own["value"] == pytest.approx(late, abs=3.0 * own["sd"])
    assert own["sd"] < 0.4e-3


AXES = {"-x,y,z": (0, 1, 2, -1, 1, 1), "y,-x,z": (1, 0, 2, 1, -1, 1)}


@pytest.mark.parametrize("line", ["y,-x,z", pytest.param("-x,y,z", marks=pytest.mark.slow)])
def test_wrong_axes_are_refused_with_the_line_that_undoes_them(line: str, tmp_path: Path) -> None:
    log, _ = made(tmp_path / "right.csv")
    order, sign = np.array(AXES[line][:3]), np.array(AXES[line][3:])
    wrong = np.empty_like(log.rate)
    wrong[:, order] = log.rate * sign
    path = Log(log.t, log.force, log.t_gyro, wrong, log.up).write(tmp_path / "wrong.csv")
    result = run("imu", path, "-q")
    assert result.return_value == 3
    assert str(result.exception).endswith(f"--gyro-axes={line}")
    assert run("imu", path, "-q", "--no-loop", f"--gyro-axes={line}").return_value == 0


def test_a_rate_in_deg_is_refused_with_its_unit(tmp_path: Path) -> None:
    log, _ = made(tmp_path / "right.csv")
    path = log.write(tmp_path / "deg.csv", rate_unit=np.degrees(1.0))
    result = run("imu", path, "-q")
    assert result.return_value == 3
    assert "--gyro-unit deg/s" in str(result.exception)


def test_turns_about_the_vertical_show_nothing(tmp_path: Path) -> None:
    """The sensor lies flat and is turned about z, over and over."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 60.0, 0.01)
    inside = t % 4.0 < 2.0
    rate = np.zeros((t.size, 3))
    rate[~inside, 2] = 2.0 * np.sin(np.pi * (t[~inside] % 4.0 - 2.0) / 2.0) ** 2
    rate += 1e-3 * rng.normal(size=rate.shape)
    force = np.tile([0.0, 0.0, 1.0], (t.size, 1)) + 3e-3 * rng.normal(size=rate.shape)
    path = Log(t, force, t, rate, force).write(tmp_path / "flat.csv")
    result = run("imu", path, "-q")
    assert result.return_value == 4
    assert "about the vertical" in str(result.exception)
    assert "turn by 135 deg" in str(result.exception.remedy)  # type: ignore[attr-defined]


def test_clipped_turns_and_gaps_are_left_out_and_counted(tmp_path: Path) -> None:
    log, _ = made(tmp_path / "right.csv", rests=16)
    top = 0.93 * np.abs(log.rate).max()
    kept = np.ones(len(log.t), bool)
    fast = np.flatnonzero(np.linalg.norm(log.rate, axis=1) > 1.0)
    lost = fast[len(fast) // 3]
    kept[lost : lost + 30] = False
    parts = (log.t, log.force, log.t, np.clip(log.rate, -top, top), log.up)
    path = Log(*(v[kept] for v in parts)).write(tmp_path / "worse.csv")
    content = report(path, "--no-loop")
    left = content["imu"]["turns_left_out"]
    assert any("clipped" in words for words in left)
    assert any("gap" in words or "missing" in words for words in left)
    assert content["imu"]["turns"] + len(left) == content["imu"]["rests"] - 1
    assert any("turns were left out" in note for note in content["notes"])


@pytest.mark.parametrize("grain", [0.25, 1.0])
def test_rates_in_coarse_steps_are_neither_clipped_nor_worse_than_raw(
    grain: float, tmp_path: Path
) -> None:
    """A smooth top read in steps is flat, and rests that are read alike are rounded alike."""
    log, _ = made(tmp_path / "right.csv", rests=16)
    coarse = np.radians(grain * np.round(np.degrees(log.rate) / grain))
    content = report(replace(log, rate=coarse).write(tmp_path / "coarse.csv"), "--no-loop")
    assert not content["imu"]["turns_left_out"]
    held = content["loop"]["errors"][0]["held_out"]
    assert held["final"] < held["raw"]
    top = np.radians(grain * np.round(np.degrees(0.9 * np.abs(log.rate).max()) / grain))
    clipped = replace(log, rate=np.clip(coarse, -top, top)).write(tmp_path / "clipped.csv")
    left = report(clipped, "--no-loop")["imu"]["turns_left_out"]
    assert any("clipped" in words for words in left)


def test_logs_at_several_temperatures_tell_what_follows_it(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    own, paths = chip(rng), []
    scale, bias = np.array([4e-4, -3e-4, 2e-4]), np.radians([0.04, 0.02, -0.05])
    for k, warm in enumerate((5.0, 25.0, 50.0)):
        there = replace(
            own, M=np.diag(1.0 + scale * (warm - 25.0)) @ own.M,
            rate_bias=own.rate_bias + bias * (warm - 25.0),
        )  # fmt: skip
        log = turned(there, rng, rests=12)
        heat = warm + 0.01 * rng.normal(size=len(log.t))
        paths.append(tmp_path / f"{k}.h5")
        write(recording_of(log.t, G0 * log.force, log.rate, heat, hz=100.0), paths[-1])
    result = run("imu", *paths, "-o", tmp_path / "out", "-q", "--json")
    names = [s["effect"] for s in json.loads(result.stdout)["loop"]["steps"]]
    assert sorted(names) == ["gyro_temperature_bias", "gyro_temperature_scale"]
    gyro = gyroscope_of(read_calibration(tmp_path / "out/calibration.yaml"))
    assert gyro is not None
    warm = np.array([0.0, 40.0])
    still = gyro.rate(np.zeros((2, 3)), np.zeros((2, 3)), warm)
    np.testing.assert_allclose(np.degrees(still[1] - still[0]), -40.0 * np.degrees(bias), atol=0.1)
    fast = gyro.rate(np.full((2, 3), 3.0), np.zeros((2, 3)), warm) - still
    np.testing.assert_allclose(fast[1] - fast[0], -3.0 * 40.0 * scale, atol=0.015)
    target = tmp_path / "corrected.h5"
    assert (
        run("apply", tmp_path / "out/calibration.yaml", paths[2], "-o", target, "-q").exception
        is None
    )
    log_rate = read(target).channels["imu0/angular_rate"].values
    assert np.abs(np.median(log_rate, axis=0)).max() < np.radians(0.1)


def test_sensors_at_rates_of_their_own(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    log = turned(chip(rng), rng, rate=100.0, gyro_rate=400.0)
    channels = {
        "imu0/acceleration": Channel(log.t, G0 * log.force, "m/s2", "acceleration", "imu0", 100.0),
        "imu0/angular_rate": Channel(log.t_gyro, log.rate, "rad/s", "angular_rate", "imu0", 400.0),
    }
    path = tmp_path / "apart.h5"
    write(Recording(channels, "apart", "hdf5", ""), path)
    content = report(path, "--no-loop")
    assert content["loop"]["errors"][0]["held_out"]["final"] < 0.2
    late = Channel(log.t_gyro + 500.0, log.rate, "rad/s", "angular_rate", "imu0", 400.0)
    write(Recording({**channels, "imu0/angular_rate": late}, "late", "hdf5", ""), tmp_path / "l.h5")
    assert run("imu", tmp_path / "l.h5", "-q").return_value in (3, 4)


@pytest.mark.slow
def test_a_plan_of_135_deg_and_two_logs_together(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    own = chip(rng)
    paths = [
        turned(own, rng, rests=19, plan=plan(19)).write(tmp_path / f"{k}.csv") for k in range(2)
    ]
    one, both = report(paths[0], "--no-loop"), report(*paths, "--no-loop")
    assert both["imu"]["turns"] == 36
    sd = [
        np.mean([p["sd"] for p in r["parameters"] if p["effect"] == "gyro_gain"])
        for r in (one, both)
    ]
    assert sd[0] < 1.5e-3
    assert sd[1] < 0.9 * sd[0]
    values = [p["value"] for p in both["parameters"] if p["effect"] == "gyro_gain"]
    sds = [p["sd"] for p in both["parameters"] if p["effect"] == "gyro_gain"]
    assert np.abs((np.array(values) - np.linalg.inv(own.M).ravel()) / sds).max() < 4.0


def test_a_plan_states_what_it_gives(tmp_path: Path) -> None:
    """The gains of logs that follow the plan, with errors as large as it assumes."""
    content = json.loads(run("design", "--imu", "--recommend", "20", "--json").stdout)
    assert len(content["turns"]) == 19
    assert content["open"] == []
    few = json.loads(run("design", "--imu", "--recommend", "12", "--json").stdout)
    assert all(few["sd"][name] > sd for name, sd in content["sd"].items())
    rng, plan = np.random.default_rng(1), hand_plan(20)
    rows = np.concatenate([of_turn(t.up, np.radians(135.0) * _signed(t.axis)) for t in plan.turns])
    found = [
        np.linalg.lstsq(rows, np.radians(0.1) * rng.normal(size=len(rows)), rcond=None)[0]
        for _ in range(400)
    ]
    np.testing.assert_allclose(np.std(found, axis=0), plan.sd, rtol=0.15)


def _signed(axis: str) -> np.ndarray:
    return (-1.0 if axis[0] == "-" else 1.0) * np.eye(3)["xyz".index(axis[1])]


def test_what_a_log_leaves_open_is_told_with_the_turns_that_show_it(tmp_path: Path) -> None:
    log, made = tmp_path / "turns.h5", tmp_path / "out"
    assert run("simulate", "imu", log, "--rests", "14", "-q").exception is None
    assert run("imu", log, "-o", made, "--no-loop", "-q").exception is None
    content = json.loads(run("design", "--imu", made / "calibration.yaml", "--json").stdout)
    assert len(content["turns"]) == 3
    assert all(content["sd"][name] < sd for name, sd in content["sd_before"].items())
    page = run("design", "--imu", made / "calibration.yaml").stdout
    assert "3 more turns" in page


@pytest.mark.slow
def test_what_is_simulated_is_found(tmp_path: Path) -> None:
    log = tmp_path / "turns.h5"
    words = ("--plant", "gyro_g_sensitivity=0.1", "--late", "0.004", "--seed", "5", "--json")
    made = json.loads(run("simulate", "imu", log, *words).stdout)
    content = json.loads(run("imu", log, "--json", "-q").stdout)
    assert [s["effect"] for s in content["loop"]["steps"]] == ["gyro_g_sensitivity"]
    own = {p["name"]: p for p in content["parameters"]}
    for i, a in enumerate("xyz"):
        for j, b in enumerate("xyz"):
            p = own[f"gyro_gain_{a}{b}"]
            assert abs(p["value"] - made["gyro_gain"][i][j]) < 5.0 * p["sd"]
            assert abs(own[f"gyro_g_sensitivity_{a}{b}"]["value"] - 0.1) < 0.02
    late = content["imu"]["gyroscope_late_s"]
    assert abs(late["value"] - 0.004) < 4.0 * late["sd"]
