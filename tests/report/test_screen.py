"""A calibrator's first screen: worth, findings and steps; what it advises can be typed as it is."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucalib.effects import catalogue
from imucalib.report.render.document import Card, Document, Text, Worth
from imucalib.report.render.text import SCREEN, render_text
from imucalib.report.sections import worst_attitude
from worlds.command import run
from worlds.places import SAMPLES

TABLE = ("lab", "paper_table_1.csv", "--gravity", "9.8061")
#: Good, cautioned and refused results, of every calibrator.
QUICK = {
    "lab, no search": (*TABLE, "--no-loop"),
    "lab, a limit broken": (*TABLE, "--no-loop", "--max-error", "1"),
    "lab, another zero": (*TABLE, "--no-loop", "--toolface-zero-axis=-y"),
    "lab, norm": ("lab", "cave_ai.csv", "--reference", "norm", "--no-loop"),
}
SLOW = {
    "lab, a wrong row": TABLE,
    "lab, mended": (*TABLE, "--fix", "10:y=-58593"),
    "lab, norm, search": ("lab", "cave_ai.csv", "--reference", "norm"),
    "lab, rests": ("lab", "positions.csv", "--recording", str(SAMPLES / "rests.mcap")),
    "actigraph": ("actigraph", "wrist_day.csv.gz"),
    "actigraph, published": ("actigraph", "wrist_day.csv.gz", "--as-published"),
    "imu": ("imu", "turns.csv.gz", "--latitude", "59.3"),
    "imu, no search": ("imu", "turns.csv.gz", "--no-loop"),
    "array": ("array", "board_part.mcap", "--board", "mimu4444_corners", "--gravity", "9.8189"),
}
CALLS = [
    *(pytest.param(call, id=name) for name, call in QUICK.items()),
    *(pytest.param(call, id=name, marks=pytest.mark.slow) for name, call in SLOW.items()),
]
#: An effect's id, a scan's, a parameter's: no word of a language.
INTERNAL = re.compile(r"\b\w+@\w+|\b[a-z]+_[a-z_]+\b")


def located(call: tuple[str, ...]) -> list[str]:
    """A call with its sample log's whole path."""
    return [str(SAMPLES / w) if (SAMPLES / w).is_file() else w for w in call]


def prose(screen: str) -> str:
    """A screen without commands and paths."""
    lines = screen.splitlines()
    typed = re.compile(r" {3}(imucal |.*/| *--)|.* \\$")
    said = "\n".join(line for line in lines[1:-1] if not typed.match(line))
    return re.sub(r"`[^`]*`|\S+/\S+|--[\w-]+\S*", "", said)


def typed(steps: list[str]) -> list[list[str]]:
    """Every command in some advice."""
    found = (c for step in steps for c in re.findall(r"`(imucal [^`]*)`", step))
    return [shlex.split(c)[1:] for c in found]


@pytest.mark.parametrize("call", CALLS)
def test_a_first_screen_is_short_in_words_and_its_commands_run(
    call: tuple[str, ...], tmp_path: Path
) -> None:
    out = tmp_path / "made"
    done = run(*located(call), "-o", out, "-q")
    card: dict[str, Any] = json.loads((out / "report.json").read_text())["card"]
    shown = run(*located(call), "-o", out).stdout
    lines = shown.splitlines()
    assert len(lines) <= SCREEN
    order = [shown.index(f"{title} ─") for title in ("Good to", "Found", "What to do next")]
    assert order == sorted(order)
    assert not INTERNAL.findall(prose(shown))
    whole = " ".join([shown, *card["found"], *card["to_do"]])
    assert "nats" not in whole
    assert str(out / "report.html") in "".join(shown.split("\n"))
    commands = typed(card["to_do"])
    usable = done.return_value in (0, 5) and not any(" --fix" in c for c in card["to_do"])
    assert commands or not usable
    runs = {0, 5, done.return_value}  # a limit that is broken may stay so
    for command in commands:
        assert run(*command).return_value in runs, command


@pytest.fixture(scope="module")
def devices(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with calibrations of two devices, and four rests of the first."""
    folder = tmp_path_factory.mktemp("devices")
    for name in ("cave_ai", "cave_bi"):
        run(*located(("lab", f"{name}.csv", "--reference", "norm")), "--no-loop", "-q", "-o",
            folder / name)  # fmt: skip
    rows = (SAMPLES / "cave_ai.csv").read_text().splitlines()
    (folder / "rests.csv").write_text("\n".join(rows[:5]) + "\n")
    return folder


AI, BI = "{}/cave_ai/calibration.yaml", "{}/cave_bi/calibration.yaml"
NORM = ("--reference", "norm")
OTHERS = {
    "check, good": ("check", AI, "{}/rests.csv", "--limit", "20mg"),
    "check, changed": ("check", AI, "cave_bi.csv"),
    "check, undecided": ("check", AI, "{}/rests.csv", "--limit", "0.02mg"),
    "compare, differ": ("compare", AI, BI),
    "compare, agree": ("compare", AI, BI, "--limit", "90mg", "--limit", "9deg"),
    "fleet": ("fleet", "cave_ai.csv", "cave_bi.csv", "cave_fb.csv", *NORM),
}


@pytest.mark.parametrize("call", OTHERS.values(), ids=OTHERS)
def test_every_card_is_a_short_screen_in_words(call: tuple[str, ...], devices: Path) -> None:
    shown = run(*located(tuple(word.replace("{}", str(devices)) for word in call))).stdout
    assert len(shown.splitlines()) <= SCREEN
    order = [shown.index(f"{title} ─") for title in ("Good to", "Found", "What to do next")]
    assert order == sorted(order)
    assert not INTERNAL.findall(re.sub(r"cave_\w+", "", prose(shown)))
    assert not re.search(r"nats|CALIBRATION|FOLDER|\.\.|,\.", prose(shown))


def test_a_calibration_prints_a_certificate_and_shows_its_residual(tmp_path: Path) -> None:
    run(*located(TABLE), "--fix", "10:y=-58593", "-q", "-o", tmp_path)
    page = (tmp_path / "report.html").read_text()
    certificate = page[page.index('class="certificate"') : page.index("<header>")]
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["provenance"]["sha256"] in certificate
    assert report["provenance"]["time"] in certificate
    assert "k = 2" in certificate
    assert "a thousandth of standard gravity" in page
    bench = report["fixture"]["effects"]
    own = [p for p in report["parameters"] if p["effect"] not in bench]
    tables = own, report["positions"]
    assert certificate.count("<tr>") == sum(1 + len(rows) for rows in tables)
    assert "10:y=-58593" in certificate
    assert "signature" in certificate
    assert page.index("<figure>") < page.index("<nav")
    assert {s["label"] for s in report["figures"][0]["series"]} >= {"raw", "before", "after"}


def test_nobody_signs_a_run_that_is_undecided(tmp_path: Path) -> None:
    run(*located(TABLE), "-q", "-o", tmp_path)
    assert json.loads((tmp_path / "report.json").read_text())["undecided"]
    assert "signature" not in (tmp_path / "report.html").read_text()


def test_a_run_that_writes_nothing_says_how_to_keep_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()  # another's
    call = located(QUICK["lab, norm"])
    shown = run(*call).stdout
    (step,) = re.findall(r"imucal (?:.|\n)*?(?=\n\S|\n\n)", shown)
    command = shlex.split(step.replace("\\\n", " "))[1:]
    assert command[-2:] == ["-o", "out_2"]
    assert run(*command).return_value == 0
    assert (tmp_path / "out_2" / "calibration.yaml").is_file()


def test_no_effect_of_the_catalogue_is_an_internal_name_in_words() -> None:
    """The test above would see one."""
    assert all(INTERNAL.search(name) for name in catalogue() if "_" in name)


@pytest.mark.parametrize("count", [1, 5, 40])
@pytest.mark.parametrize("width", [80, 120])
def test_what_has_no_room_is_counted(count: int, width: int) -> None:
    sentence = "Begin" + " with what takes a while to say.  It" * 9
    card = Card(
        tuple(Worth(f"quantity {k}", "± 1 mg", "95 %") for k in range(3)),
        (Text(sentence),) * count,
        (sentence,) * count,
    )
    document = Document("d", Text("Ready to use.", "ok"), (), card=card)
    text = render_text(document, width, color=False)
    assert len(text.splitlines()) <= SCREEN
    assert text.count("± 1 mg") == 3
    told = re.search(r"(\d+) more", text)
    shown = len(re.findall(r"^Begin", text, flags=re.M)) + len(
        re.findall(r"^\d+\. ", text, flags=re.M)
    )
    assert shown + (int(told[1]) if told else 0) == 2 * count


def card(*words: object) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(run(*words, "--json").stdout)["card"]
    return found


def test_a_check_that_passes_says_what_it_would_have_seen(devices: Path) -> None:
    told = card(
        "check", devices / "cave_ai" / "calibration.yaml", devices / "rests.csv", "--limit", "20mg"
    )
    (worth,) = told["good_to"]
    assert worth["quantity"] == "see a change of bias"
    assert "limit 20 mg, as stated" in worth["detail"]
    assert told["found"][0].startswith("Nothing shows")
    assert "imucal apply" in told["to_do"][0]
    assert "imucal check" in told["command"]


def test_an_undecided_check_names_the_rests(devices: Path) -> None:
    told = card(
        "check",
        devices / "cave_ai" / "calibration.yaml",
        devices / "rests.csv",
        "--limit",
        "0.02mg",
    )
    assert "Nothing shows" in told["found"][0]
    assert "Record these rests" in told["to_do"][0] or "accept a wider" in told["to_do"][0]


def test_a_fleet_says_what_a_device_is_good_to(tmp_path: Path) -> None:
    tables = [SAMPLES / f"cave_{n}.csv" for n in ("ai", "bi", "fb")]
    out = tmp_path / "fleet"
    done = run("fleet", *tables, "--reference", "norm", "--only", "quadratic",
               "-o", out)  # fmt: skip
    content = json.loads((out / "report.json").read_text())
    names = [w["quantity"] for w in content["card"]["good_to"]]
    assert names == ["all devices", "the worst device"]
    worst = max(content["devices"], key=lambda d: d["final_mg"])
    assert content["card"]["good_to"][1]["value"] == f"{worst['final_mg']:.3g} mg"
    assert worst["name"] in content["card"]["good_to"][1]["detail"]
    assert "Quadratic, in every device" in content["card"]["found"][0]
    assert "Good to ─" in done.stdout
    page = (out / "report.html").read_text()
    assert 'class="card"' in page
    assert "imucal fleet" in page
    assert content["figures"]


def test_a_certificate_says_its_method_in_words(tmp_path: Path) -> None:
    """Of a recording that is corrected by curves, which have ids only within."""
    run("actigraph", SAMPLES / "wrist_day.csv.gz", "-q", "-o", tmp_path)
    page = (tmp_path / "report.html").read_text()
    certificate = page[page.index('class="certificate"') : page.index("<header>")]
    assert "a curve of the response of x" in certificate
    assert "@" not in certificate
    assert certificate.count("<tr>") == 1 + 9  # the terms of curves fill four more pages
    assert "a curve of the response of x (32 terms)" in certificate


def test_a_direction_has_no_minus_before_a_zero() -> None:
    worth = worst_attitude("|a|", np.ones(1), np.array([[1.0, -0.02, 0.04]]))
    assert worth.more == "with gravity along x +1.0, y +0.0, z +0.0"


def test_the_first_figure_has_the_raw_reading_and_the_corrected_one(tmp_path: Path) -> None:
    run(*located(QUICK["lab, norm"]), "-q", "-o", tmp_path)
    first = json.loads((tmp_path / "report.json").read_text())["figures"][0]
    sizes = {s["label"]: np.abs(s["y"]).max() for s in first["series"]}
    assert sizes["after"] < 0.1 * sizes["raw"]
    assert "before" not in sizes  # which the corrected one would hide: nothing was searched for
    assert "before" not in first["caption"]


@pytest.mark.slow
def test_an_array_shows_its_board_and_noise_that_its_residuals_have(tmp_path: Path) -> None:
    run(*located(SLOW["array"]), "-q", "-o", tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    board, *others = report["figures"]
    assert {s["label"].partition(",")[0] for s in board["series"]} >= {"drawn", "found", "97 %"}
    assert "times as large" in board["caption"]
    for figure in (f for f in others if f["title"].endswith("residual against the rate")):
        noise, after = (
            next(s for s in figure["series"] if s["label"] == label)
            for label in ("noise that was fitted", "after")
        )
        ratio = np.array(after["y"]) / np.interp(after["x"], noise["x"], noise["y"])
        assert np.all((ratio > 0.5) & (ratio < 1.1)), figure["title"]
