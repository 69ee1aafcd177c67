"""A column that the user names as a driver: what follows it is found, named and applied without."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from imucalib import cli
from imucalib.calibrators.lab.position_table import read_position_table
from imucalib.effects import known
from imucalib.errors import UsageError


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


def test_a_heading_with_a_colon_is_found_again(tmp_path: Path) -> None:
    sheet = _sheet(tmp_path / "sheet.csv", 3.0, "bias")
    text = sheet.read_text().replace("supply_V", "supply: V")
    sheet.write_text(text)
    for heading in ("supply: V", "supply  V"):
        table = read_position_table(sheet, {"driver": heading})
        assert table.names["driver"] == "supply: V"
    with pytest.raises(UsageError, match="no column is called"):
        read_position_table(sheet, {"driver": "supply V"})


@pytest.mark.slow
def test_a_column_that_nobody_names_takes_no_part_and_is_told(tmp_path: Path) -> None:
    run = _run("lab", _sheet(tmp_path / "sheet.csv", 0.0, "bias"), "-o", tmp_path / "out")
    assert "columns that take no part: supply_V (--columns driver=supply_V" in run.stderr
    named = _run(
        "lab", tmp_path / "sheet.csv", "--columns", "driver=supply_V", "-o", tmp_path / "out"
    )
    assert "take no part" not in named.stderr
    assert not json.loads((tmp_path / "out/report.json").read_text())["loop"]["steps"]


def test_several_drivers_may_be_named(tmp_path: Path) -> None:
    sheet = _sheet(tmp_path / "sheet.csv", 0.0, "bias")
    table = read_position_table(sheet, {"driver": "supply_V", "driver_2": "supply_V"})
    assert {"driver", "driver_2"} <= set(table.columns)
    with pytest.raises(UsageError, match="driver_two"):
        read_position_table(sheet, {"driver_two": "supply_V"})


_ANGLES = {"tool_face": "tool_face"}


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
