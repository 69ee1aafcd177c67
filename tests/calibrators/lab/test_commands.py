"""`imucal lab` as a user meets it: outputs, exit codes, and an error message for every mistake."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import pytest
from click.testing import CliRunner, Result

import imucalib
from imucalib import cli
from imucalib.errors import ImucalError
from worlds.places import ROOT

SAMPLES = ROOT / "sample_logs"
SCHEMAS = Path(imucalib.__file__).parent / "schemas"
REPAIR = ("--fix", "10:y=-45.86119676")


def run(*arguments: object) -> Result:
    """The command, with what `main` does about errors."""
    runner = CliRunner()
    result = runner.invoke(cli.cli, [str(a) for a in arguments], standalone_mode=False)
    if isinstance(result.exception, ImucalError):
        result.exit_code = result.exception.exit_code
    return result


def validated(text: str, name: str) -> dict:
    content = json.loads(text)
    schema = json.loads((SCHEMAS / f"{name}.schema.json").read_text(encoding="utf-8"))
    jsonschema.validate(content, schema)
    return content


def table(path: Path, **columns: object) -> Path:
    """The sample bench with some columns changed (None drops one)."""
    lines = (SAMPLES / "bench.csv").read_text().splitlines()
    names = lines[0].split(",")
    values = {n: [line.split(",")[k] for line in lines[1:]] for k, n in enumerate(names)}
    values |= columns  # type: ignore[arg-type]
    values = {n: v for n, v in values.items() if v is not None}
    rows = zip(*values.values(), strict=True)
    path.write_text("\n".join([",".join(values), *(",".join(r) for r in rows)]) + "\n")
    return path


def column(name: str) -> list[str]:
    lines = (SAMPLES / "bench.csv").read_text().splitlines()
    k = lines[0].split(",").index(name)
    return [line.split(",")[k] for line in lines[1:]]


def spoilt(name: str, row: int, cell: str) -> list[str]:
    cells = column(name)
    cells[row - 1] = cell
    return cells


SWAPPED = {"inclination": column("tool_face"), "tool_face": column("inclination")}


@pytest.mark.slow
def test_a_wrong_record_is_named_and_left_to_the_user(tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = run("lab", SAMPLES / "bench.csv", "-o", out)
    assert result.return_value == 5
    report = validated((out / "report.json").read_text(), "report")
    assert report["status"] == "marginal"
    (slip,) = report["faults"]
    assert (slip["kind"], slip["what"]) == ("cell", "row 10: y lost its sign")
    assert "--fix 10:y=-45.86119676" in result.stdout.replace("\n", " ")
    page = (out / "report.html").read_text(encoding="utf-8")
    assert len(page) < 1_000_000
    assert "http" not in page.replace("http://www.w3.org/2000/svg", "")


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
    ("change", "code", "words"),
    [
        ({"x_mg": None}, 3, "no column for x"),
        ({"inclination": None}, 3, "no column for inclination"),
        ({"y_mg": spoilt("y_mg", 5, "oops")}, 3, "row 5, column y_mg: 'oops'"),
        ({"z_mg": spoilt("z_mg", 7, "")}, 3, "row 7, column z_mg: the cell is empty"),
        ({"x_mg": spoilt("x_mg", 3, "nan")}, 3, "row 3, column x_mg"),
        ({"tool_face": spoilt("tool_face", 1, "1e4")}, 2, "row 1, column tool_face"),
        (SWAPPED, 2, "--swap-angles"),
        ({"inclination": ["30"] * 32}, 4, "leave open"),
    ],
)
def test_bad_tables(tmp_path: Path, change: dict, code: int, words: str) -> None:
    path = table(tmp_path / "bad.csv", **change)
    result = run("lab", path, "-o", tmp_path / "out", "--no-loop")
    assert isinstance(result.exception, ImucalError), result.exception
    assert result.exit_code == code
    assert words in str(result.exception)
    assert not (tmp_path / "out").exists()


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
    assert result.exit_code == code
    assert words in str(result.exception)
    assert not (tmp_path / "out").exists()


def test_missing_file_and_positions_that_do_not_match(tmp_path: Path) -> None:
    assert run("lab", tmp_path / "none.csv").exit_code == 3
    short = tmp_path / "short.csv"
    lines = (SAMPLES / "positions.csv").read_text().splitlines()
    short.write_text("\n".join(lines[:-2]) + "\n")
    result = run("lab", short, "--recording", SAMPLES / "rests.mcap")
    assert result.exit_code == 2
    assert "22 positions, the recording 24 rests" in str(result.exception)
