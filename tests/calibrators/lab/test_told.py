"""What a lab report must say of itself: the order of its rows, its floor, what it cannot see."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from imucalib.calibrators.lab.calibrate import LabSettings
from imucalib.calibrators.lab.files import LabFiles, calibrate_files
from imucalib.calibrators.lab.position_table import read_position_table
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import LabRun, run_lab
from imucalib.cli import cli as main
from worlds import plain_bench, sheets


def calibrated(path: Path, request: LabRequest | None = None) -> tuple[LabRun, list[str]]:
    said: list[str] = []
    return calibrate_files(LabFiles(path), request or LabRequest(unit="mg"), said.append), said


def timed(sheet: sheets.Sheet, path: Path, order: np.ndarray) -> Path:
    time = 60.0 * np.arange(len(sheet.reading))
    rows = np.column_stack([time, sheet.inclination, sheet.tool_face, sheet.reading])[order]
    text = "\n".join(",".join(f"{v:.10g}" for v in row) for row in rows)
    path.write_text(f"time_s,inclination,tool_face,x_mg,y_mg,z_mg\n{text}\n", encoding="utf-8")
    return path


def test_rows_out_of_order_are_put_in_order_by_their_time(tmp_path: Path) -> None:
    sheet = sheets.bench(3, effect="bias_drift")
    n = len(sheet.reading)
    plain, quiet = calibrated(timed(sheet, tmp_path / "a.csv", np.arange(n)))
    mixed = np.random.default_rng(0).permutation(n)
    shuffled, said = calibrated(timed(sheet, tmp_path / "b.csv", mixed))
    np.testing.assert_allclose(shuffled.result.final.theta, plain.result.final.theta, atol=1e-9)
    assert any("in the order of their time" in line for line in said)
    assert not any("in the order of their time" in line for line in quiet)


@pytest.fixture(scope="module")
def faces(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six faces twice, with a cubic response that scales take over whole."""
    u = np.vstack([np.eye(3), -np.eye(3)] * 2)
    rng = np.random.default_rng(0)
    reading = 1000.0 * u + 30.0 * u**3 + 0.5 * rng.standard_normal(u.shape)
    path = tmp_path_factory.mktemp("faces") / "six.csv"
    rows = np.column_stack([u, reading])
    np.savetxt(path, rows, delimiter=",", header="ux,uy,uz,x_mg,y_mg,z_mg", comments="")
    return path


def test_what_the_positions_cannot_show_is_told_everywhere(faces: Path) -> None:
    command = ["lab", str(faces), "--reference", "direction"]
    text = " ".join(CliRunner().invoke(main, command).output.split())
    assert "These data cannot show, whatever the size (rms at a typical one): cubic" in text
    assert "What could hide" in text
    assert "Nothing to do" not in text
    report = json.loads(CliRunner().invoke(main, [*command, "--json", "--quiet"]).stdout)
    assert any("cannot show cubic" in line for line in report["loop"]["advice"])
    (absorbed,) = report["loop"]["not_testable"]
    assert absorbed["effect"] == "cubic"
    assert absorbed["shift"] == pytest.approx(3.0, rel=0.1)  # its typical 3 mg/g³ on these faces


def test_the_floor_is_measured_or_unknown(faces: Path, tmp_path: Path) -> None:
    direction = LabRequest(unit="mg", reference="direction")
    repeated = calibrated(faces, direction)[0].outcome.error.floor
    assert repeated == pytest.approx(0.5 * np.sqrt(3.0), rel=0.5)
    rows = faces.read_text().splitlines()
    cells = rows[3].split(",")
    rows[3] = ",".join([*cells[:3], f"{float(cells[3]) + 300.0:.3f}", *cells[4:]])
    (tmp_path / "wrong.csv").write_text("\n".join(rows) + "\n")
    wrong = calibrated(tmp_path / "wrong.csv", direction)[0].outcome.error.floor
    assert wrong < 3.0 * repeated
    nowhere = sheets.bench(3, name="spread").write(tmp_path / "spread.csv")
    assert np.isnan(calibrated(nowhere)[0].outcome.error.floor)


def test_who_has_no_dials_is_told_a_direction() -> None:
    table = Path(__file__).parents[3] / "sample_logs" / "cave_ab.csv"
    run, _ = calibrated(table, LabRequest(unit="g", reference="norm"))
    asked = [line for line in run.outcome.advice if "One more position" in line]
    assert asked
    assert not any("tool-face" in line for line in asked)


def test_advice_names_the_row_of_a_slip_whatever_was_left_out(tmp_path: Path) -> None:
    """It begins with row 19 of the sheet, the 18th of those that are kept."""
    bench = plain_bench.Bench(plain_bench.Plan(0, (("slip", 30.0),)))
    path = bench.write(tmp_path / "sheet.csv")
    settings = LabSettings(only=("slip",))
    request = LabRequest(unit="mg", exclude=(3,), settings=settings)
    run = run_lab(read_position_table(path), request)
    (told,) = [text for text in run.outcome.advice if "clamp" in text]
    assert told.startswith("From row 19 on the tool stands turned about its own axis in its clamp.")
    assert "Return to the first position at the end" in told
