"""What became of the rests, as a user asks for it: `inspect --rests`, and --shortest-rest."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner, Result

from imucalib.cli import cli
from imucalib.errors import ImucalError

RATE, G = 100.0, 9.80665


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli, [str(a) for a in arguments], standalone_mode=False)


def written(path: Path, values: np.ndarray) -> Path:
    with h5py.File(path, "w") as file:
        data = file.create_dataset("accelerometer", data=values)
        data.attrs["unit"] = "m/s^2"
        file["time"] = np.arange(len(values)) / RATE
        file["time"].attrs["unit"] = "s"
    return path


def tumble(path: Path, seconds: float, count: int = 12, slow: float = 0.0) -> Path:
    """Rests of some seconds in random attitudes; at the end a turn of some mg/s for 30 s."""
    rng = np.random.default_rng(0)
    parts = []
    for _ in range(count):
        direction = rng.normal(size=3)
        direction *= G / np.linalg.norm(direction)
        parts.append(direction + rng.normal(0, 6.0, (250, 3)))
        parts.append(np.tile(direction, (round(seconds * RATE), 1)))
    if slow:
        parts.append(direction + rng.normal(0, 6.0, (250, 3)))
        across = np.cross(direction, [0.3, 0.5, 0.8]) / G
        parts.append(direction + np.arange(3000)[:, None] / RATE * slow * 1e-3 * G * across)
    values = np.concatenate(parts)
    return written(path, values + rng.normal(0, 0.02, values.shape))


def listed(*arguments: object) -> list[dict[str, object]]:
    result = run("inspect", *arguments, "--rests", "--json", "-q")
    assert result.exit_code == 0, result.output
    rests: list[dict[str, object]] = json.loads(result.stdout)["rests"]
    return rests


def test_every_candidate_is_listed_with_its_reason(tmp_path: Path) -> None:
    path = tumble(tmp_path / "log.h5", 3.0, slow=2.0)
    rests = listed(path)
    assert sum(bool(r["rest"]) for r in rests) == 12
    (turn,) = (r for r in rests if r["reason"] == "turning")
    assert turn["length_s"] == pytest.approx(30.0, abs=4.0)
    assert turn["noise"] == pytest.approx(0.02, rel=0.2)
    shown = run("inspect", path, "--rests").stdout
    assert "12 rests" in shown
    assert "turning" in shown
    assert "Candidates for rests" not in run("inspect", path).stdout


def test_the_page_draws_them(tmp_path: Path) -> None:
    path, page = tumble(tmp_path / "log.h5", 3.0, slow=2.0), tmp_path / "rests.html"
    assert run("inspect", path, "--rests", "--html", page, "-q").exit_code == 0
    text = page.read_text(encoding="utf-8")
    assert text.count("<svg") >= 2
    assert "Drift over time" in text
    again = run("inspect", path, "--rests", "--html", path)
    assert isinstance(again.exception, ImucalError)  # never onto its input


def test_a_recording_without_a_rest_says_why(tmp_path: Path) -> None:
    values = np.array([0, 0, G]) + np.random.default_rng(0).normal(0, 0.02, (3000, 3))
    values[50::100] = 0.0
    path = written(tmp_path / "log.h5", values)
    result = run("inspect", path, "--unit", "m/s2")
    assert "no rest in it: of what came near one, 1 dropouts" in " ".join(result.stdout.split())


def test_the_shortest_rest_is_the_users(tmp_path: Path) -> None:
    path = tumble(tmp_path / "log.h5", 0.7)
    assert not any(r["rest"] for r in listed(path))
    assert sum(bool(r["rest"]) for r in listed(path, "--shortest-rest", 0.6)) == 12
    refused = run("lab", path, "--reference", "norm", "-o", tmp_path / "out")
    assert isinstance(refused.exception, ImucalError)
    assert "too short" in refused.exception.what
    assert "1 s or more" in str(refused.exception.remedy)
    out = tmp_path / "out"
    done = run("lab", path, "--reference", "norm", "--shortest-rest", 0.6, "-o", out, "--no-loop")
    assert done.exception is None, done.exception
    assert (out / "calibration.yaml").exists()


@pytest.mark.parametrize("value", ["0", "-1", "nan", "1e9"])
@pytest.mark.parametrize("command", ["inspect", "lab"])
def test_an_impossible_shortest_rest_is_refused(command: str, value: str, tmp_path: Path) -> None:
    path = tumble(tmp_path / "log.h5", 1.5, count=2)
    result = run(command, path, f"--shortest-rest={value}")
    assert isinstance(result.exception, ImucalError)
    assert "--shortest-rest" in result.exception.what
