"""What became of the rests, as a user asks for it: `inspect --rests`, and --shortest-rest."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

from worlds.command import run

RATE, G = 100.0, 9.80665


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
