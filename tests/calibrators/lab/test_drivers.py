"""A column that the user names as a driver: what follows it is found, named and applied without."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from imucalib import cli
from imucalib.effects import known


def _sheet(path: Path, size: float, kind: str) -> Path:
    """Thirty-six set attitudes, noise of 0.5 mg, and a supply of 11.5 to 12.5 V that wanders."""
    rng = np.random.default_rng(4)
    inclination, tool_face = 10.0 * rng.integers(-8, 9, 36), 30.0 * rng.integers(0, 12, 36)
    i, t = np.deg2rad(inclination), np.deg2rad(tool_face)
    supply = rng.uniform(11.5, 12.5, 36)
    force = np.stack([np.cos(i) * np.sin(t), np.cos(i) * np.cos(t), np.sin(i)], axis=1)
    along = force if kind == "scale" else np.array([[0.3, -1.0, 0.5]])
    reading = 1000.0 * force * [1.004, 0.997, 1.002] + [12.0, -7.0, 3.0]
    reading += 2.0 * size * (supply - 12.0)[:, None] * along + 0.5 * rng.standard_normal((36, 3))
    rows = np.column_stack([inclination, tool_face, reading, supply])
    heading = "inclination,tool_face,x_mg,y_mg,z_mg,supply_V"
    np.savetxt(path, rows, "%.6g", ",", header=heading, comments="")
    return path


def _run(*words: str | Path) -> Result:
    return CliRunner().invoke(cli.cli, [str(word) for word in words], standalone_mode=False)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["bias", "scale"])
def test_what_follows_a_named_column_is_found_and_done_without(tmp_path: Path, kind: str) -> None:
    sheet, out = _sheet(tmp_path / "sheet.csv", 3.0, kind), tmp_path / "out"
    run = _run("lab", sheet, "--columns", "driver=supply_V", "-o", out)
    assert run.exit_code == 0, run.stderr
    (step,) = json.loads((out / "report.json").read_text())["loop"]["steps"]
    assert step["effect"].startswith(f"follows@{kind}:supply_V:1")
    assert step["certain"]
    assert "against column supply_V" in (out / "report.html").read_text()
    again = _run("check", out / "calibration.yaml", sheet)
    assert again.return_value in (None, 0), again.output
    assert "is taken as in the middle" not in again.output
    rests = tmp_path / "rests.csv"
    lines = [f"{k / 50},0,0,9.81" for k in range(500)]
    rests.write_text("\n".join(["time_s,acc_x_m/s2,acc_y_m/s2,acc_z_m/s2", *lines]) + "\n")
    applied = _run("apply", out / "calibration.yaml", rests, "-o", tmp_path / "applied.csv")
    assert applied.exit_code == 0, applied.stderr
    told = " ".join(applied.output.split())
    assert "the recording has no column supply_V" in told
    assert "11.5 to 12.5" in told


@pytest.mark.parametrize(
    "value",
    [
        "bias",
        "bias::1:2",
        "bias:supply:1:0",
        "scale:supply:1:x",
        "bias:supply:1:-1",
        "gain:supply:1:2",
    ],
)
def test_values_that_name_no_driver(value: str) -> None:
    assert known(f"follows@{value}") is None
