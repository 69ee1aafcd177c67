"""What differs in one power-up beyond its bias and seat: told with its number, in plain numpy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.calibrators.lab.calibrate import LabSettings
from imucalib.calibrators.lab.files import LabFiles, calibrate_files
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import LabRun

Array = NDArray[np.float64]

SCATTER, NOISE = 0.05, 0.5  # deg, mg


def _force(inclination: Array, tool_face: Array) -> Array:
    i, t = np.radians(inclination), np.radians(tool_face)
    return np.stack([np.cos(i) * np.sin(t), np.cos(i) * np.cos(t), np.sin(i)], axis=-1)


def _sensor(rng: np.random.Generator) -> Array:
    lower = np.tril(0.004 * rng.standard_normal((3, 3)), -1)
    return np.eye(3) + np.diag(0.006 * rng.standard_normal(3)) + lower


def _sheets(seed: int, what: str) -> list[str]:
    """Three power-ups of 32 positions, whose third has something of its own."""
    rng = np.random.default_rng(seed)
    inclination = np.repeat([-75.0, -45.0, -20.0, 0.0, 15.0, 30.0, 50.0, 80.0], 4)
    tool_face = np.tile([0.0, 90.0, 180.0, 270.0], 8) + np.repeat(np.arange(8) * 11.0, 4)
    bias, gain, other = 12.0 * rng.standard_normal(3), _sensor(rng), _sensor(rng)
    found = []
    for session in range(3):
        last = session == 2
        i = inclination + SCATTER * np.repeat(rng.standard_normal(8), 4)
        t = tool_face + SCATTER * rng.standard_normal(32)
        i = i + 0.5 * (last and what == "inclination")
        of = other if last and what == "sensor" else gain
        of = of @ np.diag([1.003, 0.998, 1.002]) if last and what == "scale" else of
        reading = 1000.0 * _force(i, t) @ of.T + bias + rng.standard_normal(3)
        loud = 8.0 if last and what == "noise" else 1.0
        reading = reading + loud * NOISE * rng.standard_normal((32, 3))
        rows = np.column_stack([inclination, tool_face, reading])
        lines = [",".join(f"{v:.5f}" for v in row) for row in rows]
        found.append("\n".join(("inclination,tool_face,x_mg,y_mg,z_mg", *lines)) + "\n")
    return found


def _run(folder: Path, sheets: list[str], *declare: str) -> LabRun:
    paths = [folder / f"day_{k}.csv" for k in range(len(sheets))]
    for path, text in zip(paths, sheets, strict=True):
        path.write_text(text)
    request = replace(LabRequest(), settings=LabSettings(declare=declare))
    return calibrate_files(LabFiles(paths[0], others=tuple(paths[1:])), request, lambda text: None)


@pytest.mark.slow
@pytest.mark.parametrize("what", ["scale", "inclination"])
def test_what_one_session_has_of_its_own_is_named(what: str, tmp_path: Path) -> None:
    """The scale was a certain drift; the dial nothing, hidden in scatter six times too wide."""
    run = _run(tmp_path, _sheets(1, what))
    assert run.result.loop is not None
    assert [s.effect for s in run.result.loop.steps] == [f"session@3:{what}"]
    error = run.result.error
    assert error.held_out.final < error.held_out.base
    assert np.isnan(error.floor)  # what two sessions differ by is no noise


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_of_sessions_alike_none_is_named(seed: int, tmp_path: Path) -> None:
    run = _run(tmp_path, _sheets(seed, ""))
    assert run.result.loop is not None
    assert not run.result.loop.steps
