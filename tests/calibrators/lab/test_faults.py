"""Slips and mistakes as a user meets them: named, never passed, settled by pasting a line."""

from __future__ import annotations

import json
import re
import shlex
from dataclasses import replace
from itertools import permutations, product
from pathlib import Path

import jsonschema
import numpy as np
import pytest

import imucalib
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.calibrators.lab.repairs import Repairs, repair, repairs_of
from imucalib.errors import ImucalError, UsageError
from worlds import sheets
from worlds.command import run
from worlds.places import SAMPLES


def lab(path: Path, *options: str) -> tuple[int, str, dict]:
    """Exit code, what is said, and the report (empty for a refusal)."""
    result = run("lab", path, "--json", "-q", *options)
    if result.exception:
        return result.return_value, str(result.exception), {}
    report = json.loads(result.stdout)
    return result.return_value, " | ".join(report["undecided"]), report


@pytest.mark.slow
@pytest.mark.parametrize("kind", sheets.KINDS)
def test_pasting_the_line_ends_the_matter(tmp_path: Path, kind: str) -> None:
    clean = sheets.bench(11, name="paper" if kind != "vertical" else "sweeps", scatter=0.1)
    made = sheets.slipped(clean, kind, np.random.default_rng(6))
    path = made.write(tmp_path / "sheet.csv")
    code, text, report = lab(path)
    assert code in (2, 3, 5)
    assert report.get("status", "refused") != "ok"
    assert made.slip.line in text, text
    code, text, report = lab(path, *shlex.split(made.slip.line))
    assert (code, text, report["status"]) == (0, "", "ok")
    assert not report["faults"]


def test_a_slip_that_keeps_the_fit_from_settling_is_named_on_a_card(tmp_path: Path) -> None:
    """Figures of such a fit say nothing, and are not shown."""
    rows = (SAMPLES / "bench.csv").read_text().splitlines()
    for row, column in ((10, 3), (14, 4)):  # its own slip mended, and another one made
        cells = rows[row].split(",")
        cells[column] = str(-float(cells[column]))
        rows[row] = ",".join(cells)
    path = tmp_path / "sheet.csv"
    path.write_text("\n".join(rows) + "\n")
    out = ("-o", tmp_path / "out", "--export", "matlab")
    code, text, report = lab(path, "--latitude", "59.3", *out)
    assert (code, report["status"]) == (5, "failed")
    assert "row 14: z lost its sign" in text
    assert "--fix 14:z=815.2" in report["card"]["to_do"][0]
    assert report["card"]["good_to"] == []
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Good to" not in page
    assert "nothing is missing" not in page.partition("<nav")[0]
    assert not list((tmp_path / "out").glob("*.m"))
    refused = run("export", tmp_path / "out" / "calibration.yaml", "--to", "matlab").exception
    assert "did not settle" in str(refused)


def _in_the_tool(turn: np.ndarray, path: Path) -> Path:
    """Thirty-six set attitudes of a sensor that stands in the tool by a turn, in mg."""
    rng = np.random.default_rng(4)
    inclination, tool_face = 10.0 * rng.integers(-8, 9, 36), 30.0 * rng.integers(0, 12, 36)
    i, t = np.deg2rad(inclination), np.deg2rad(tool_face)
    force = np.stack([np.cos(i) * np.sin(t), np.cos(i) * np.cos(t), np.sin(i)], axis=1)
    reading = 1000.0 * force @ turn.T * [1.004, 0.997, 1.002] + [12.0, -7.0, 3.0]
    reading += 0.5 * rng.standard_normal((36, 3))
    heading, rows = "inclination,tool_face,x_mg,y_mg,z_mg", np.c_[inclination, tool_face, reading]
    np.savetxt(path, rows, "%.6g", ",", header=heading, comments="")
    return path


TURNS = [
    np.eye(3)[list(order)] * np.array(sign)[:, None]
    for order in permutations(range(3))
    for sign in product((1.0, -1.0), repeat=3)
]


@pytest.mark.parametrize("turn", [t for t in TURNS if np.linalg.det(t) > 0.0], ids=str)
def test_every_way_to_stand_in_the_tool_is_calibrated_alike(
    turn: np.ndarray, tmp_path: Path
) -> None:
    """Exactly along its axes too, where three turns one after the other lose one of them."""
    path = _in_the_tool(turn, tmp_path / "sheet.csv")
    code, _, report = lab(path, "--no-loop", "--axes=x,y,z")
    assert (code, report["status"]) == (0, "ok")
    assert report["loop"]["errors"][0]["held_out"]["final"] < 1.2
    sd = [p["sd"] for p in report["parameters"] if p["name"].startswith("mounting")]
    assert max(sd) < 0.02


@pytest.mark.parametrize(
    ("name", "order", "sign"),
    [
        ("paper", (0, 1, 2), (1, -1, 1)),
        pytest.param("spread", (0, 1, 2), (1, -1, 1), marks=pytest.mark.slow),
        pytest.param("paper", (0, 2, 1), (-1, 1, -1), marks=pytest.mark.slow),
        pytest.param("spread", (0, 2, 1), (-1, 1, -1), marks=pytest.mark.slow),
    ],
)
def test_the_part_whose_axes_are_turned_is_named(
    name: str, order: tuple[int, ...], sign: tuple[int, ...], tmp_path: Path
) -> None:
    """Two rows of five, whatever the order of work, which no plain fit of all rows survives."""
    clean = sheets.bench(11, name=name, scatter=0.1)
    made = sheets.part_turned(clean, round(0.6 * len(clean.reading)), order, sign)
    code, text, _ = lab(made.write(tmp_path / "sheet.csv"))
    assert code == 5
    assert made.slip.line in text, text


@pytest.mark.slow
def test_a_turned_sensor_is_a_question_until_it_is_answered(tmp_path: Path) -> None:
    made = sheets.axes(sheets.bench(4, name="spread"), (1, 0, 2), (1, -1, 1))
    path = made.write(tmp_path / "sheet.csv")
    code, text, report = lab(path)
    assert (code, report["status"]) == (5, "marginal")
    assert "--toolface-zero-axis" in text
    for line in re.findall(r"--(?:axes|toolface-zero-axis)[= ][-+xyz,]+", text):
        code, text, report = lab(path, *shlex.split(line.rstrip(",")))
        assert (code, text) == (0, ""), line


def table() -> PositionTable:
    columns = {"inclination": [0, 10, 20, 30, 40], "tool_face": [0, 0, 0, 5, 5]}
    columns |= {"x": [1, 2, 3, 4, 5], "y": [0] * 5, "z": [9] * 5}
    values = {k: np.array(v, float) for k, v in columns.items()}
    return PositionTable(values, {k: k for k in values}, {}, np.arange(1, 6), "sheet", "")


@pytest.mark.parametrize(
    ("texts", "column", "values", "lost"),
    [
        ((("2,4",), (), ()), "x", [1, 4, 3, 2, 5], ()),
        (((), ("1,4",), ()), "x", [2, 3, 4, 1, 5], ()),
        (((), ("4,1",), ()), "x", [4, 1, 2, 3, 5], ()),
        (((), (), ("readings:2-4=-1",)), "x", [1, 3, 4, 2, 5], (4,)),
        (((), (), ("inclination=1",)), "inclination", [40, 0, 10, 20, 30], (1,)),
    ],
)
def test_what_the_options_do_to_rows(
    texts: tuple[tuple[str, ...], ...], column: str, values: list[float], lost: tuple[int, ...]
) -> None:
    repairs = repairs_of(*texts, (), None)
    changed, left = repair(table(), repairs, (), False)
    assert changed.columns[column].tolist() == values
    assert left == lost
    assert changed.columns["tool_face"].tolist() == table().columns["tool_face"].tolist()


def test_the_axes_of_a_part_are_those_of_the_whole_table_read_once_more() -> None:
    repairs = repairs_of((), (), (), ("-z,x,y", "2-3:y,-x,z"), None)
    whole = repair(table(), repairs_of((), (), (), ("-z,x,y",), None), (), False)[0].raw()
    changed = repair(table(), repairs, (), False)[0].raw()
    assert changed[[0, 3, 4]].tolist() == whole[[0, 3, 4]].tolist()
    assert changed[1:3].tolist() == (whole[1:3][:, [1, 0, 2]] * [1.0, -1.0, 1.0]).tolist()
    with pytest.raises(UsageError, match="once for the whole"):
        repairs_of((), (), (), ("-z,x,y", "y,x,z"), None)


@pytest.mark.parametrize(
    ("swaps", "shifts", "axes", "words"),
    [
        (("3",), (), None, "--swap"),
        (("3,9",), (), None, "no row 9"),
        ((), ("x=1",), None, "--shift"),
        ((), ("readings:2-4=2",), None, "1 or -1"),
        ((), (), "x,y", "--axes"),
        ((), (), "x,x,z", "once each"),
        ((), (), "3:y,x,z", "not ROWS"),
        ((), (), "3-9:y,x,z", "no row 9"),
    ],
)
def test_lines_that_are_wrong_are_refused(
    swaps: tuple[str, ...], shifts: tuple[str, ...], axes: str | None, words: str
) -> None:
    with pytest.raises(UsageError, match=re.escape(words)):
        repair(table(), repairs_of(swaps, (), shifts, (axes,) if axes else (), None), (), False)
    assert repair(table(), Repairs(), (), False)[1] == ()


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


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["bias", "scale"])
def test_what_follows_a_named_column_is_found_and_done_without(tmp_path: Path, kind: str) -> None:
    sheet, out = _sheet(tmp_path / "sheet.csv", 3.0, kind), tmp_path / "out"
    done = run("lab", sheet, "--columns", "driver=supply_V", "-o", out)
    assert done.exception is None, done.stderr
    (step,) = json.loads((out / "report.json").read_text())["loop"]["steps"]
    assert step["effect"].startswith(f"follows@{kind}:supply_V:1")
    assert step["certain"]
    assert "against column supply_V" in (out / "report.html").read_text()
    again = run("check", out / "calibration.yaml", sheet)
    assert again.return_value in (None, 0), again.output
    assert "is taken as in the middle" not in again.output
    rests = tmp_path / "rests.csv"
    lines = [f"{k / 50},0,0,9.81" for k in range(500)]
    rests.write_text("\n".join(["time_s,acc_x_m/s2,acc_y_m/s2,acc_z_m/s2", *lines]) + "\n")
    applied = run("apply", out / "calibration.yaml", rests, "-o", tmp_path / "applied.csv")
    assert applied.exception is None, applied.stderr
    told = " ".join(applied.output.split())
    assert "the recording has no column supply_V" in told
    assert "11.5 to 12.5" in told


SCHEMAS = Path(imucalib.__file__).parent / "schemas"
REPAIR = ("--fix", "10:y=-45.86119676")


def validated(text: str, name: str) -> dict:
    content = json.loads(text)
    schema = json.loads((SCHEMAS / f"{name}.schema.json").read_text(encoding="utf-8"))
    jsonschema.validate(content, schema)
    return content


@pytest.mark.slow
def test_the_repaired_bench_names_the_dial_and_passes(tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = run("lab", SAMPLES / "bench.csv", *REPAIR, "-o", out, "--json")
    assert result.return_value == 0
    report = validated(result.stdout, "report")
    assert report == json.loads((out / "report.json").read_text())
    assert [s["effect"] for s in report["loop"]["steps"]] == ["inclination_zero"]
    (zero,) = report["loop"]["steps"][0]["parameters"]
    assert abs(zero["value"] - 0.8) < 4.5 * zero["sd"]
    error = report["loop"]["errors"][0]["held_out"]
    assert error["final"] < error["base"] < error["raw"]
    refused = {r["effect"] for r in report["loop"]["rejected"]}
    assert {"quadratic", "cubic", "bias_drift"} <= refused


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (("--unit", "m/s2"), 3, "norm would be"),
        (("--unit", "furlong"), 2, "unknown unit"),
        (("--unit", "counts"), 2, "--lsb"),
        (("--declare", "temperature_bias"), 2, "no temperature was recorded"),
        (("--without", "quadratc"), 2, "did you mean: quadratic"),
        (("--model", "13"), 2, "unknown model"),
        (("--convention", "mine"), 2, "unknown convention"),
        (("--exclude", "40"), 2, "no such row"),
        (("--fix", "40:y=1"), 2, "no such cell"),
        (("--train", "1-3"), 4, "positions give"),
        (("--toolface-sense", "counter-clockwise"), 3, "mirror image"),
        (("--columns", "x=nope"), 2, "no column is called 'nope'"),
    ],
)
def test_bad_options(tmp_path: Path, options: tuple[str, ...], code: int, words: str) -> None:
    result = run("lab", SAMPLES / "bench.csv", "-o", tmp_path / "out", "--no-loop", *options)
    assert isinstance(result.exception, ImucalError), result.exception
    assert result.return_value == code
    assert words in str(result.exception)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("axis", [0, 2])
@pytest.mark.parametrize("options", [(), ("--reference", "norm")])
def test_an_axis_that_never_changes_is_named(
    options: tuple[str, ...], axis: int, tmp_path: Path
) -> None:
    clean = sheets.bench(11, name="paper", scatter=0.1)
    reading = np.array(clean.reading)
    reading[:, axis] = reading[0, axis]
    code, said, _ = lab(replace(clean, reading=reading).write(tmp_path / "dead.csv"), *options)
    assert code == 3
    assert f"{'xyz'[axis]} reads" in said
    assert f"--columns {'xyz'[axis]}=" in said
