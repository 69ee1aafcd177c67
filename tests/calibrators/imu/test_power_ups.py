"""Several logs of one IMU: never worse than one alone, whatever a power-up does to the bias."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imucalib.writers import write
from worlds.command import run
from worlds.recordings import recording_of
from worlds.turned_imu import G0, Chip, chip, turned


def report(*arguments: object) -> dict:  # type: ignore[type-arg]
    result = run("imu", *arguments, "--json", "-q")
    assert result.exception is None, result.exception
    return json.loads(result.stdout)  # type: ignore[no-any-return]


def logs_of(folder: Path, chips: list[Chip], rng: np.random.Generator, rests: int) -> list[Path]:
    return [turned(own, rng, rests=rests).write(folder / f"{k}.csv") for k, own in enumerate(chips)]


def powered_up(own: Chip, rng: np.random.Generator, apart: float, count: int) -> list[Chip]:
    """The chip with biases that scatter by `apart` g and 0.1 deg/s."""
    return [
        replace(
            own,
            force_bias=own.force_bias + apart * rng.normal(size=3),
            rate_bias=own.rate_bias + np.radians(0.1) * rng.normal(size=3),
        )
        for _ in range(count)
    ]


def off_by(content: dict, own: Chip) -> float:  # type: ignore[type-arg]
    """Rms of gains and accelerometer's scale that are off."""
    found = {p["name"]: p["value"] for p in content["parameters"]}
    gain = [found[f"gyro_gain_{a}{b}"] for a in "xyz" for b in "xyz"]
    scale = [1.0 + found[f"scale_{a}"] for a in "xyz"]
    away = np.r_[np.ravel(gain) - np.linalg.inv(own.M).ravel(), scale - np.diag(own.S)]
    return float(np.sqrt(np.mean(away**2)))


@pytest.mark.parametrize(
    ("count", "apart"),
    [
        (2, 0.02),
        pytest.param(2, 0.0, marks=pytest.mark.slow),
        pytest.param(2, 0.005, marks=pytest.mark.slow),
        pytest.param(3, 0.02, marks=pytest.mark.slow),
    ],
)
def test_several_power_ups_are_no_worse_than_one(count: int, apart: float, tmp_path: Path) -> None:
    """Ten times worse as long as one bias was all logs', and PASSED."""
    rng = np.random.default_rng(31)
    own = chip(rng)
    chips = powered_up(own, rng, apart, count)
    paths = logs_of(tmp_path, chips, rng, 12)
    alone = [report(path, "--no-loop") for path in paths]
    both = report(*paths, "--no-loop")
    held = [r["loop"]["errors"][0]["held_out"]["final"] for r in alone]
    assert both["loop"]["errors"][0]["held_out"]["final"] < 1.2 * max(held)
    assert off_by(both, own) < 1.2 * np.sqrt(np.mean([off_by(r, own) ** 2 for r in alone]))
    assert both["status"] == "ok"
    after = both["between_sessions"]["next_power_up"]
    for one, axis in zip(after, range(3), strict=True):
        for there in chips:
            assert abs(one["value"] - 1e3 * there.force_bias[axis]) < one["half_of_95"]


def test_a_scale_that_one_log_has_of_its_own_is_told(tmp_path: Path) -> None:
    """What no power-up changes: the logs are no one calibration, and which parameter says so."""
    rng = np.random.default_rng(32)
    own = chip(rng)
    other = replace(own, S=own.S @ np.diag([1.0, 1.004, 1.0]))
    content = report(*logs_of(tmp_path, [own, other], rng, 12), "--no-loop")
    assert content["status"] == "marginal"
    assert any("accelerometer's scale differs" in words for words in content["reasons"])


def test_the_page_says_which_bias_is_stated(tmp_path: Path) -> None:
    rng = np.random.default_rng(33)
    paths = logs_of(tmp_path, powered_up(chip(rng), rng, 0.005, 2), rng, 10)
    result = run("imu", *paths, "--no-loop", "-o", tmp_path / "out", "--full")
    assert "bias after a power-up" in result.stdout
    assert "states the mean of the power-ups" in " ".join(result.stdout.split())
    assert "next_power_up" in (tmp_path / "out/calibration.yaml").read_text()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [41, 42])
def test_a_bias_that_follows_the_temperature_is_no_power_ups(seed: int, tmp_path: Path) -> None:
    """Three logs at temperatures of their own: the law is told from biases that scatter, and no lag
    from what is no more than the temperature."""
    rng = np.random.default_rng(seed)
    own, slope, paths = chip(rng), np.array([8e-4, -3e-4, 5e-4]), []
    for k, warm in enumerate((5.0, 25.0, 50.0)):
        bias = own.force_bias + slope * (warm - 25.0) + 3e-4 * rng.normal(size=3)
        log = turned(replace(own, force_bias=bias), rng, rests=14)
        heat = warm + 0.3 * np.sin(log.t / 40.0) + 0.01 * rng.normal(size=len(log.t))
        paths.append(tmp_path / f"{k}.h5")
        write(recording_of(log.t, G0 * log.force, log.rate, heat, hz=100.0), paths[-1])
    content = report(*paths)
    told = [step["effect"] for step in content["loop"]["steps"]]
    assert "temperature_bias" in told
    assert not any(name.startswith("thermal_lag") for name in told)
    found = {p["name"]: p for p in content["parameters"]}
    for axis, true in zip("xyz", slope, strict=True):
        one = found[f"temperature_bias_{axis}"]
        assert abs(one["value"] - 1e3 * true) < 4.0 * one["sd"]
    held = content["loop"]["errors"][1]["held_out"]
    assert held["final"] < 0.4 * held["base"]
