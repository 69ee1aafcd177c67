"""`imucal FILE`: what a file is, how it would be read, what is wrong, and what to type next."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest
from click.testing import Result

from worlds.command import run
from worlds.places import SAMPLES

ROWS, TABLE = (
    [line for line in (SAMPLES / name).read_text().splitlines() if line[0] != "#"]
    for name in ("cave_ai.csv", "paper_table_1.csv")
)


def said(done: Result) -> str:
    return done.stdout or str(done.exception)


def commands(text: str) -> list[str]:
    """Every command of a page: within a line, or on lines of its own that a shell takes as one."""
    whole = re.sub(r" \\\n\s*", " ", text)
    found = re.findall(r"`(imucal [^`]*)`|^\s+(imucal .*)$", whole, re.M)
    return [" ".join((one or other).split()) for one, other in found]


@pytest.mark.parametrize(
    ("name", "kind", "command"),
    [
        ("paper_table_1.csv", "inclination and tool-face are known", "imucal lab"),
        ("cave_ai.csv", "readings at rest", "--reference norm"),
        ("positions.csv", "A plan of positions", "--recording LOG"),
        ("rests.mcap", "24 still segments", "--reference norm"),
        ("turns.csv.gz", "24 still segments", "imucal imu"),
        ("board_part.mcap", "8 accelerometers", "imucal array"),
        ("wrist_day.csv.gz", "1 accelerometer", "imucal actigraph"),
    ],
)
def test_a_file_is_told_with_the_next_command(name: str, kind: str, command: str) -> None:
    file = SAMPLES / name
    page = said(run(file))
    assert " ".join(page.split()).count(kind) >= 1
    assert said(run("inspect", file)) == page
    assert any(command in c and str(file) in c for c in commands(page)), page
    content = json.loads(run(file, "--json").stdout)
    assert commands("\n".join(content["next"])) == commands(page)


def test_the_next_command_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (command,) = commands(said(run(SAMPLES / "cave_ai.csv")))
    assert run(*shlex.split(command)[1:], "--no-loop", "-q").return_value == 0
    page = said(run("out/calibration.yaml"))
    assert "A calibration by lab, status ok" in page
    assert run(*shlex.split(commands(page)[0])[1:]).return_value == 0
    assert "report.html" in said(run("out/report.json"))


@pytest.mark.parametrize(
    ("change", "what", "mend"),
    [
        (lambda r: [*r[:3], r[3].replace(".20", "2.0"), *r[4:]], "row 3: its |a| is", "--fix 3:z="),
        (lambda r: ["toolface_deg,inclination_deg,raw_x,raw_y,raw_z", *r[1:]], "exchanged",
         "--swap-angles"),
        (lambda r: [r[0], r[1].replace("0", "O", 1), *r[2:]], "is not a number", "--exclude 1"),
        (lambda r: [r[0].replace("inclination_deg", "inc (deg from vertical)"), *r[1:]], "",
         "--inclination-zero"),
        (lambda r: [r[0].replace("raw_x,raw_y,raw_z", "raw_z,raw_x,raw_y"), *r[1:]],
         "stands turned by 90 or 180 deg in the tool",
         "else --axes=z,x,y if columns or dial are misread: imucal lab"),
    ],
    ids=["ten times", "columns", "letter", "zero", "mounting"],
)  # fmt: skip
def test_what_is_wrong_is_said_with_what_mends_it(
    change: object, what: str, mend: str, tmp_path: Path
) -> None:
    assert callable(change)
    file = tmp_path / "table.csv"
    file.write_text("\n".join(change(TABLE)) + "\n")
    page = " ".join(said(run(file)).split())
    assert what in page
    assert mend in page


def test_counts_are_told_with_their_scale(tmp_path: Path) -> None:
    lines = [ROWS[0]]
    for line in ROWS[1:]:
        lines.append(",".join(f"{16384 * float(c):.0f}" for c in line.split(",")))
    file = tmp_path / "counts.csv"
    file.write_text("\n".join(lines) + "\n")
    page = said(run(file))
    assert re.search(r"--unit counts\s+--lsb\s+16\d{3}", page)


def test_what_was_corrected_is_no_calibration_of_the_sensor(tmp_path: Path) -> None:
    made, once, twice = tmp_path / "made", tmp_path / "once.mcap", tmp_path / "twice"
    log, quick = SAMPLES / "turns.csv.gz", ("--no-loop", "-q", "-o")
    assert run("imu", log, *quick, made).return_value == 0
    assert run("apply", made / "calibration.yaml", log, "-o", once, "-q").return_value == 0
    page = said(run(once))
    assert "repeat the one before" not in page  # its axes are mixed: no step of a converter is left
    assert run("imu", once, *quick, twice).return_value == 0
    report = json.loads((twice / "report.json").read_text())
    assert report["status"] == "marginal"
    assert "corrected already" in report["reasons"][0]
    assert "from which it was made" in report["card"]["to_do"][0]
    assert not any("apply" in step for step in report["card"]["to_do"])  # which would be refused


def test_values_of_a_column_of_words_are_named_without_a_count_of_pieces() -> None:
    page = " ".join(said(run(SAMPLES / "wrist_day.csv.gz")).split())
    assert "column 'Activity' is SB, LPA" in page
    assert "rows)" not in page


def test_a_table_of_two_sensors_has_readings_once_one_is_named(tmp_path: Path) -> None:
    lines = [line.split(",") for line in (SAMPLES / "bench.csv").read_text().splitlines()[1:]]
    heads = [f"G{a} {s} [mg]" for s in ("Left", "Right") for a in "xyz"]
    rows = [",".join([*row, *row[2:]]) for row in lines]
    file = tmp_path / "sheet.csv"
    file.write_text("\n".join([",".join(["inclination", "tool_face", *heads]), *rows]) + "\n")
    asked = said(run(file))
    (name,) = re.findall(r"--sensor (\S+)$", asked)
    page = said(run(file, "--sensor", name))
    assert "A plan of positions" not in page
    assert any(one.startswith("imucal lab") and "LOG" not in one for one in commands(page)), page


def in_volts(path: Path) -> Path:
    """The table of paper 004, headed right and with its lost sign, in volts about 2.5 V."""
    lines = ["tool_face [deg];incl [deg];Gx [V];Gy [V];Gz [V]"]
    for row in TABLE[1:]:
        cells = row.split(",")
        volts = (f"{2.5 + 1.25e-6 * float(c):.6f}" for c in cells[2:5])
        lines.append(";".join([cells[1], cells[0], *volts]))
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_table_in_volts_is_told_with_the_command_that_reads_it(tmp_path: Path) -> None:
    table = in_volts(tmp_path / "volts.csv")
    page = said(run(table))
    assert "counted from an offset" in " ".join(page.split())
    (command,) = commands(page)
    words = shlex.split(command)
    assert words[:3] == ["imucal", "lab", str(table)]
    assert words[-2:] == ["-o", "out"]
    again = said(run(*words[2:-2]))
    assert "counted from an offset" not in " ".join(again.split())


def test_a_mirrored_table_is_told_with_a_whole_command(tmp_path: Path) -> None:
    table = tmp_path / "mirrored.csv"
    table.write_text(
        "\n".join(
            ["toolface_deg,inclination_deg,raw_x,raw_y,raw_z"]
            + [
                ",".join([c[1], c[0], str(-float(c[2])), *c[3:]])
                for c in (r.split(",") for r in TABLE[1:])
            ]
        )
    )
    page = said(run(table))
    assert "a mirror image of the angles" in " ".join(page.split())
    (command,) = commands(page)
    assert f"imucal lab {table} --" in command
    assert "mirror image" not in said(
        run("lab", *shlex.split(command)[2:-2], "--no-loop", "-o", tmp_path / "o")
    )
