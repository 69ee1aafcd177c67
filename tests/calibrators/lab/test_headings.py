"""Position tables as the trade writes them: headings, units, degree signs, spreadsheets."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from imucalib.arrays import Array
from imucalib.calibrators.lab.bench import raw_unit
from imucalib.calibrators.lab.checks import observations_of, warmth_note
from imucalib.calibrators.lab.headings import bare
from imucalib.calibrators.lab.position_table import read_position_table
from imucalib.calibrators.lab.request import LabRequest
from imucalib.cli import cli
from imucalib.core.references import unit_vector
from imucalib.errors import UnreadableInput, UsageError
from worlds.places import ROOT

ROWS = [(10.5, 90.0, 0.1, 0.97, 0.18), (-45.0, 180.25, -0.7, 0.02, -0.7), (0.0, 0.0, 0.0, 1, 0.0)]


@pytest.mark.parametrize(
    ("text", "name", "unit", "zero"),
    [
        ("Inclination (deg from vertical)", "inclination", "deg", "vertical"),
        ("Inc from vertical [°]", "inc", "°", "vertical"),
        ("Neigung zur Senkrechten (Grad)", "neigung", "deg", "vertical"),
        ("inclination from the horizontal", "inclination", "", "horizontal"),
        ("Inclination (grad)", "inclination", "grad", ""),
        ("Tool-face (rad)", "tool_face", "rad", ""),
    ],
)
def test_the_parts_of_a_heading(text: str, name: str, unit: str, zero: str) -> None:
    found = bare(text)
    assert (found.name, found.unit, found.zero) == (name, unit, zero)


def test_inclination_from_the_vertical_is_asked_about(tmp_path: Path) -> None:
    text = (ROOT / "sample_logs" / "bench.csv").read_text()
    path = tmp_path / "t.csv"
    line = next(row for row in text.split("\n") if "inclination" in row and "," in row)
    new = line.replace("inclination", "Inclination (deg from vertical)", 1)
    path.write_text(text.replace(line, new))
    found = CliRunner().invoke(cli, ["lab", str(path), "--no-loop"])
    assert isinstance(found.exception, UsageError)
    assert "--inclination-zero vertical" in str(found.exception)


def workbook(path: Path) -> Path:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    sheet = book.active
    for row in [("Bench 7",), (), ("Inclination", "Tool-face", "Gx", "Gy", "Gz"),
                ("deg", "deg", "g", "g", "g"), *ROWS]:  # fmt: skip
        sheet.append(row)
    book.save(path)
    return path


def test_a_spreadsheet_is_a_table(tmp_path: Path) -> None:
    table = read_position_table(workbook(tmp_path / "t.xlsx"))
    np.testing.assert_array_equal(table.raw(), np.array(ROWS)[:, 2:])
    assert table.unit["x"] == "g"


def test_a_damaged_spreadsheet_is_refused(tmp_path: Path) -> None:
    path = workbook(tmp_path / "t.xlsx")
    data = path.read_bytes()
    for size in range(len(data) // 2, len(data) - 1, 97):
        path.write_bytes(data[:size])
        with pytest.raises(UnreadableInput):
            read_position_table(path)


@pytest.mark.parametrize(
    ("heading", "of"),
    [
        ("temperature_K", lambda c: c + 273.15),
        ("Temperature (°F)", lambda c: 1.8 * c + 32.0),
        ("temp_degF", lambda c: 1.8 * c + 32.0),
        ("Temp [°C]", lambda c: c),
        ("temperature", lambda c: c),
    ],
)
def test_a_temperature_is_read_in_the_unit_of_its_heading(
    heading: str, of: Callable[[Array], Array], tmp_path: Path
) -> None:
    celsius = np.linspace(18.0, 31.0, 12)
    path = _warm_sheet(tmp_path / "t.csv", heading, of(celsius))
    table = read_position_table(path)
    raw = raw_unit(table, None, None)
    context = observations_of(table, raw, LabRequest()).context
    np.testing.assert_allclose(context["temperature"], celsius, atol=1e-3)
    assert warmth_note(table) == (() if heading != "temperature" else (
        "temperature: no unit is stated, taken as degC",))  # fmt: skip


def test_a_temperature_that_celsius_cannot_be_is_no_guess(tmp_path: Path) -> None:
    path = _warm_sheet(tmp_path / "t.csv", "temperature", np.linspace(291.0, 304.0, 12))
    table = read_position_table(path)
    with pytest.raises(UsageError, match="no unit is stated") as told:
        observations_of(table, raw_unit(table, None, None), LabRequest())
    assert "temperature_K" in told.value.remedy


def _warm_sheet(path: Path, heading: str, warm: Array) -> Path:
    i, t = np.repeat([0.0, 30.0, 60.0], 4), np.tile([0.0, 90.0, 180.0, 270.0], 3)
    force = unit_vector(np.deg2rad(i), np.deg2rad(t))
    rows = np.column_stack([i, t, 1000.0 * force, warm])
    head = f"inclination,tool_face,x_mg,y_mg,z_mg,{heading}"
    np.savetxt(path, rows, "%.6f", ",", header=head, comments="", encoding="utf-8")
    return path
