"""A bench that jumps: every row is looked at, and the user says which part stands as it was set."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.core.effect import Context
from imucalib.effects import families
from imucalib.posterior.search.catalogue import scan_of
from worlds import sheets
from worlds.bench import bench
from worlds.command import run


def jumped(kind: str, row: int, seed: int = 5, name: str = "spread") -> sheets.Sheet:
    """A sheet whose rows from this one on stand otherwise, by 0.6 deg in all."""
    clean = sheets.bench(seed, scatter=0.05, name=name)
    after = np.arange(len(clean.inclination)) >= row - 1
    i, t = clean.inclination, clean.tool_face
    if kind == "none":
        return clean
    if kind == "inclination_step":
        moved = sheets.direction(i + 0.6 * after, t)
    elif kind == "slip:z":
        moved = sheets.direction(i, t + 0.6 * after)
    else:
        u = sheets.direction(i, t)
        turn = np.cross(np.deg2rad([0.4, -0.4, 0.2]), u)
        moved = u + after[:, None] * turn
    off = 1000.0 * (moved - sheets.direction(i, t))
    return sheets.Sheet(i, t, clean.reading + off)


def calibrated(path: Path, *options: str) -> tuple[int, dict]:
    result = run("lab", path, "--json", "-q", *options)
    return result.return_value, json.loads(result.stdout)


def names(report: dict) -> list[str]:
    return [step["effect"] for step in report["loop"]["steps"]]


@pytest.mark.parametrize("kind", ["slip", "inclination_step", "scale_step"])
def test_every_row_of_a_sheet_is_looked_at(kind: str) -> None:
    """With an even share of the scan's prior, be it tried at first or after."""
    data = bench(1, n=60)
    family = families()[kind]
    whole = scan_of(data, family)
    assert whole is not None
    looked = {member.name.partition("@")[2].partition(":")[0] for member in whole.members}
    assert looked == {f"record{k}" for k in range(7, 56)}
    assert sum(np.exp(m.log_weight) for m in whole.members) == pytest.approx(1.0)


@pytest.mark.parametrize("kind", ["slip", "inclination_step", "scale_step"])
@pytest.mark.parametrize("at", [7, 151, 293])
def test_a_long_sheet_is_looked_at_row_by_row_around_what_leads(kind: str, at: int) -> None:
    data = bench(1, n=300)
    family = families()[kind]
    values = family.values(data.context)
    lead = min(values, key=lambda v: abs(int(v.removeprefix("record").partition(":")[0]) - at))
    finer = scan_of(data, family, [lead])
    assert finer is not None
    assert f"{kind}@record{at}" in {member.name for member in finer.members}
    assert sum(np.exp(m.log_weight) for m in finer.members) == pytest.approx(1.0)


def test_no_jump_is_looked_for_among_rows_that_are_trusted() -> None:
    data = bench(1, n=60)
    said = {"trusted_from": np.full(60, 9.0), "trusted_to": np.full(60, 29.0)}
    context = Context(60, {**data.context.covariates, **said})
    looked = {int(v[6:].partition(":")[0]) for v in families()["slip"].values(context)}
    assert looked == {*range(7, 11), *range(31, 56)}


@pytest.mark.parametrize(
    ("kind", "row"),
    [
        ("slip", 13),
        *(pytest.param("slip:z", r, marks=pytest.mark.slow) for r in (9, 12)),
        pytest.param("slip", 17, marks=pytest.mark.slow),
    ],
)
def test_after_a_slip_the_user_says_which_part_stands(tmp_path: Path, kind: str, row: int) -> None:
    """The same readings come of a tool that slipped and of one that was seated wrongly before; the
    interval holds both, and what the advised lines say decides."""
    sheet = jumped(kind, row)
    path = sheet.write(tmp_path / "sheet.csv")
    code, report = calibrated(path)
    assert code == 5
    (name,) = names(report)
    assert name.partition(":")[0] == f"slip@record{row}"
    (said,) = report["undecided"]
    told = []
    for part in (f"1-{row - 1}", f"{row}-{len(sheet.reading)}"):
        assert f"--trust {part}" in said
        code, one = calibrated(path, *shlex.split(f"--trust {part}"))
        assert (code, one["undecided"]) == (0, [])
        told.append(_mounting(one)[0])
    still = _mounting(calibrated(jumped("none", row).write(tmp_path / "still.csv"))[1])[0]
    assert np.linalg.norm(told[0] - still) < 0.15
    assert np.linalg.norm(told[1] - still) == pytest.approx(0.6, abs=0.15)
    off, sd = _mounting(report)
    assert np.all(np.abs(off - told) < 1.96 * sd + 0.1)


def _mounting(report: dict) -> tuple[Array, Array]:
    """deg: the mounting's parameters and their standard deviations."""
    own = [p for p in report["parameters"] if p["effect"] == "mounting"]
    return np.array([p["value"] for p in own]), np.array([p["sd"] for p in own])


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["slip:z", "slip", "inclination_step"])
@pytest.mark.parametrize("row", [8, 11, 14, 17])
def test_the_row_of_a_jump_is_that_of_the_bench(tmp_path: Path, kind: str, row: int) -> None:
    """By one row at most, and no sound cell is accused."""
    made = jumped(kind, row, seed=row)
    _, report = calibrated(made.write(tmp_path / "sheet.csv"))
    jumps = [n for n in names(report) if "@record" in n]
    assert jumps, names(report)
    where = [int(n.split("@record")[1].partition(":")[0]) for n in jumps]
    assert min(abs(w - row) for w in where) <= 1
    assert not report["faults"]


def test_rows_that_are_not_there_cannot_be_trusted(tmp_path: Path) -> None:
    path = jumped("slip", 12).write(tmp_path / "sheet.csv")
    result = run("lab", path, "--trust", "40-50")
    assert result.return_value == 2
    assert "--trust names no row of the table" in str(result.exception)
