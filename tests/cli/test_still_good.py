"""`imucal check` and `imucal compare` as they are typed: exit codes, JSON, files, bad input."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imucalib.calibration.file import read, to_yaml, write_whole
from imucalib.calibrators.lab.simulation import BenchPlan, simulate_recording, simulate_table
from imucalib.report.render.text import SCREEN
from imucalib.writers import write as write_recording
from worlds.command import run
from worlds.instrument import Bench, four, instrument, positions

SHEET = Bench(known=True, noise=0.25, setting=0.01)
RESTS = Bench(noise=0.25)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Calibrations by angles and by gravity alone, and logs of the same tool before and after."""
    at = tmp_path_factory.mktemp("tool")
    rng = np.random.default_rng(14)
    tool = instrument(rng)
    for name, bench in (("angles", SHEET), ("norm", RESTS)):
        table = at / f"{name}.csv"
        table.write_text(bench.table(tool, positions(30, rng), rng))
        options = () if bench.known else ("--reference", "norm")
        assert run("lab", table, "-o", at / name, "--no-loop", "-q", *options).return_value == 0
    turned = tool.changed("mounting", 0.15, np.array([0.6, 0.0, 0.8]))
    moved = tool.changed("bias", 2.5, np.array([0.0, 1.0, 0.0]))
    for name, one in (("same", tool), ("turned", turned), ("moved", moved)):
        for kind, bench in (("sheet", SHEET), ("rests", RESTS)):
            (at / f"{name}_{kind}.csv").write_text(bench.table(one, four(rng), rng))
    return at


@pytest.mark.slow
@pytest.mark.parametrize(
    ("calibration", "log", "code", "cause"),
    [
        ("angles", "same_sheet", 0, ""),
        ("angles", "turned_sheet", 1, "mounting"),
        ("angles", "moved_sheet", 1, "bias"),
        ("angles", "turned_rests", 0, ""),  # gravity's size alone does not see it
        ("norm", "same_rests", 0, ""),
        ("norm", "moved_rests", 1, "bias"),
        ("norm", "turned_sheet", 0, ""),
    ],
)
def test_four_positions_tell(
    folder: Path, calibration: str, log: str, code: int, cause: str
) -> None:
    done = run("check", folder / calibration / "calibration.yaml", folder / f"{log}.csv", "--json")
    content = json.loads(done.stdout)
    assert done.return_value == content["exit_code"] == code
    (sensor,) = content["sensors"]
    assert sensor["directions_known"] == (calibration == "angles" and log.endswith("sheet"))
    if cause:
        assert cause in sensor["causes"]
        assert cause in content["explanation"][0]


@pytest.mark.slow
def test_a_limit_that_could_not_be_seen_is_undecided_with_a_plan(folder: Path) -> None:
    log, calibration = folder / "same_rests.csv", folder / "norm" / "calibration.yaml"
    done = run("check", calibration, log, "--limit", "0.6mg", "--json")
    content = json.loads(done.stdout)
    assert done.return_value == 5
    assert content["limits"]["bias"]["value"] == 0.6
    assert 0 < len(content["next"]["rests"]) <= 12
    text = run("check", calibration, log, "--limit", "0.6mg", "--full")
    assert "Record these rests too" in text.stdout
    assert run("check", calibration, log, "--limit", "0.6mg", "-q").stdout == ""
    wide = run("check", calibration, log, "--noise", "2mg", "--json")
    sizes = (json.loads(r.stdout)["sensors"][0]["changes"][0]["could_see"] for r in (wide, done))
    assert next(sizes) > 4.0 * next(sizes)


@pytest.mark.slow
def test_a_recording_with_rests_is_a_log_too(folder: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    table = simulate_table(BenchPlan("rings", 24), rng)
    log = tmp_path / "log.csv"
    write_recording(simulate_recording(table, rng, rate=50.0, rest=2.0), log)
    options = ("--reference", "norm", "--no-loop", "-q")
    assert run("lab", log, "-o", tmp_path / "log", *options).return_value == 0
    done = run("check", tmp_path / "log" / "calibration.yaml", log, "--json")
    content = json.loads(done.stdout)
    assert done.return_value == 0
    (sensor,) = content["sensors"]
    assert sensor["readings"] == 24
    assert sensor["misfits"][0]["reading"].startswith("rest at ")
    corrected = tmp_path / "corrected.h5"
    calibration = tmp_path / "log" / "calibration.yaml"
    assert run("apply", calibration, log, "-o", corrected, "-q").return_value == 0
    again = run("check", calibration, corrected)
    assert again.return_value == 2
    assert "is corrected" in str(again.exception)
    lost = run("check", calibration, log, "--sensor", "imu7")
    assert lost.return_value == 2


def test_a_page_and_no_file_overwritten(folder: Path, tmp_path: Path) -> None:
    page, calibration = tmp_path / "p.html", folder / "norm" / "calibration.yaml"
    for _ in range(2):
        done = run("check", calibration, folder / "same_rests.csv", "--html", page, "-q")
        assert done.return_value == (2 if done.exception else 0)
    assert done.return_value == 2
    text = page.read_text()
    assert "Readings" in text
    card = text[text.index('class="card"') : text.index("<nav")]
    assert "Misfit of the readings" in card
    assert "unchanged, 95 %" in card


@pytest.mark.slow
@pytest.mark.parametrize("command", ["check", "compare"])
def test_a_long_result_is_one_screen_unless_all_is_shown(
    command: str, folder: Path, tmp_path: Path
) -> None:
    rng = np.random.default_rng(8)
    calibration, log = folder / "angles" / "calibration.yaml", tmp_path / "long.csv"
    log.write_text(SHEET.table(instrument(rng), positions(70, rng), rng))
    loaded = read(calibration)
    many = replace(loaded, reasons=tuple(f"reason {k}" for k in range(300)))
    write_whole(tmp_path / "b.yaml", to_yaml(many))
    call = {"check": (calibration, log), "compare": (calibration, tmp_path / "b.yaml")}[command]
    screen = run(command, *call).stdout.splitlines()
    assert len(screen) <= SCREEN
    assert max(map(len, screen)) <= 80
    assert screen[-1].endswith("--full, or --html")
    whole = run(command, *call, "--full").stdout
    assert len(whole.splitlines()) > SCREEN
    assert f"command imucal {command} " in " ".join(whole.split())


def test_compare_says_what_differs(folder: Path, tmp_path: Path) -> None:
    angles, norm = folder / "angles" / "calibration.yaml", folder / "norm" / "calibration.yaml"
    rng, tool = np.random.default_rng(11), instrument(np.random.default_rng(14))
    table = tmp_path / "later.csv"
    moved = tool.changed("bias", 3.0, np.array([1.0, 0.0, 0.0]))
    table.write_text(RESTS.table(moved, positions(30, rng), rng))
    assert run("lab", table, "-o", tmp_path / "later", "--no-loop", "-q", "--reference",
               "norm").return_value == 0  # fmt: skip
    later = tmp_path / "later" / "calibration.yaml"
    done = run("compare", norm, later, "--limit", "1.5mg", "--json",
               "--dates", "2026-01-01,2026-04-11", "--html", tmp_path / "c.html")  # fmt: skip
    content = json.loads(done.stdout)
    assert done.return_value == content["exit_code"] == 1
    (worst,) = content["worst"]
    assert worst["difference"] == pytest.approx(3.0, abs=4.0 * worst["sd"])
    assert abs(content["drift"]["per_day"]) == pytest.approx(0.03, rel=0.3)
    assert "2026-0" in content["drift"]["reached"]
    assert "Control chart" in (tmp_path / "c.html").read_text()
    text = run("compare", norm, later, "--limit", "5mg")
    assert text.return_value == 0
    assert "within the limit" in text.stdout
    mixed = run("compare", norm, angles)
    assert mixed.return_value == 0
    assert "only angles ties a frame" in " ".join(mixed.stdout.split()).lower()
    assert run("compare", norm, angles, "--limit", "0.1deg").return_value == 2
    assert run("compare", norm).return_value == 2
    assert run("compare", norm, norm, "-q").stdout == ""
    assert "same recording" in " ".join(run("compare", norm, norm).stdout.split())
