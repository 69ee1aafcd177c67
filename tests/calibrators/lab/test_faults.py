"""Slips of hand as a user meets them: told with a line, never passed, settled by pasting it."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from imucalib import cli
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.calibrators.lab.repairs import Repairs, repaired, repairs_of
from imucalib.errors import ImucalError, UsageError
from worlds import sheets


def lab(path: Path, *options: str) -> tuple[int, str, dict]:
    """Exit code, what is said, and the report (empty for a refusal)."""
    arguments = ["lab", str(path), "--json", "-q", *options]
    result = CliRunner().invoke(cli.cli, arguments, standalone_mode=False)
    if isinstance(result.exception, ImucalError):
        return result.exception.exit_code, str(result.exception), {}
    assert result.exception is None, result.exception
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


def test_the_norm_claims_nothing_about_places(tmp_path: Path) -> None:
    clean = sheets.bench(4, name="spread")
    for made in (sheets.exchanged(clean, 3, 9), sheets.mistyped(clean, 5, "inclination", 20.0)):
        path = made.write(tmp_path / "sheet.csv")
        assert lab(path, "--reference", "norm")[:2] == (0, "")


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
    changed, left = repaired(table(), repairs, (), False)
    assert changed.columns[column].tolist() == values
    assert left == lost
    assert changed.columns["tool_face"].tolist() == table().columns["tool_face"].tolist()


def test_the_axes_of_a_part_are_those_of_the_whole_table_read_once_more() -> None:
    repairs = repairs_of((), (), (), ("-z,x,y", "2-3:y,-x,z"), None)
    whole = repaired(table(), repairs_of((), (), (), ("-z,x,y",), None), (), False)[0].raw()
    changed = repaired(table(), repairs, (), False)[0].raw()
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
        repaired(table(), repairs_of(swaps, (), shifts, (axes,) if axes else (), None), (), False)
    assert repaired(table(), Repairs(), (), False)[1] == ()
