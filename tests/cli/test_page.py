"""What a calibration prints: one page, or with --full all; JSON holds the card and figures."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner, Result

from imucalib import cli
from worlds.places import SAMPLES


def lab(*arguments: str) -> Result:
    words = ["lab", str(SAMPLES / "cave_ai.csv"), "--reference", "norm", "--no-loop", *arguments]
    return CliRunner().invoke(cli.cli, words, standalone_mode=False, catch_exceptions=False)


def test_one_page_and_the_whole() -> None:
    page, whole = lab().stdout, lab("--full").stdout
    assert len(page.splitlines()) <= 60 < len(whole.splitlines())
    assert max(len(line) for line in page.splitlines()) <= 80
    for title in ("Good to ─", "Found ─", "What to do ─"):
        assert title in page
    assert "Positions ─" in whole
    assert "Positions ─" not in page
    assert "--full shows all" in page
    # What holds figures alone has no heading in characters.
    assert "--full" not in whole.split("Not shown here")[1]
    assert "Residual before and after" in whole.split("Not shown here")[1]
    assert "Residual before and after ─" not in whole


@pytest.mark.slow
@pytest.mark.parametrize(
    ("call", "answer"),
    [
        (("inspect", "board_part.mcap"), "--triad NAME"),
        (("inspect", "rests.mcap", "--rests"), "Candidates"),
        (("inspect", "board.h5", "--noise"), "more rows: --full"),
        (("inspect", "wrist_day.csv.gz", "--rests"), "more rows: --full"),
        (("design", "paper_table_1.csv"), "Positions to add ─"),
        (("design", "--recommend", "24"), "24        -90.0        0.0"),
        (("effects",), "All accelerometers, by what they need ─"),
        (("lab", "paper_table_1.csv", "--gravity", "9.8061", "--no-loop"), "Good to ─"),
    ],
    ids=lambda v: " ".join(v) if isinstance(v, tuple) else "",
)
def test_every_command_prints_one_page_of_80_columns(call: tuple[str, ...], answer: str) -> None:
    words = [str(SAMPLES / w) if (SAMPLES / w).is_file() else w for w in call]
    done = CliRunner().invoke(cli.cli, words, standalone_mode=False, catch_exceptions=False)
    lines = done.stdout.splitlines()
    assert len(lines) <= 60
    assert max(map(len, lines)) <= 80
    assert any(answer in line for line in lines)


def test_json_says_what_the_page_says() -> None:
    done = lab("--json")
    content, page = json.loads(done.stdout), " ".join(lab().stdout.split())
    worth = content["card"]["good_to"][0]
    assert f"{worth['quantity']} {worth['value']}" in page
    held = content["loop"]["errors"][0]["held_out"]["final"]
    assert worth["value"] == f"{held:.2g} mg"
    titles = [figure["title"] for figure in content["figures"]]
    assert "Attitudes seen and the error left" in titles
    errors = next(f for f in content["figures"] if f["title"] == "Error of |a| against row")
    after = next(s for s in errors["series"] if s["label"] == "after")
    assert after["names"][0] == "row 1"
    rms = (sum(v * v for v in after["y"]) / len(after["y"])) ** 0.5
    assert abs(rms - held) < 1e-3 * held


def test_verbose_tells_the_cost_on_stderr() -> None:
    done = lab("--verbose")
    assert "calibrating took" in done.stderr
    assert "calibrating took" not in done.stdout
    assert lab("-q", "--verbose").stderr == ""
