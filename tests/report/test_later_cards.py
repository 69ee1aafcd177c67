"""Cards of what comes after a calibration: to see, what shows, what to do."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from imucalib import cli
from worlds.places import SAMPLES


def run(*words: object) -> Result:
    return CliRunner().invoke(
        cli.cli, [str(w) for w in words], standalone_mode=False, catch_exceptions=False
    )


@pytest.fixture(scope="module")
def tools(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Two devices, each calibrated by itself, and six rests of the first."""
    folder = tmp_path_factory.mktemp("tools")
    for name in ("cave_ai", "cave_jd"):
        run("lab", SAMPLES / f"{name}.csv", "--reference", "norm", "--no-loop", "-q", "-o",
            folder / name)  # fmt: skip
    rows = (SAMPLES / "cave_ai.csv").read_text().splitlines()
    (folder / "rests.csv").write_text("\n".join(rows[:9]) + "\n")
    return {
        "ai": folder / "cave_ai" / "calibration.yaml",
        "jd": folder / "cave_jd" / "calibration.yaml",
        "rests": folder / "rests.csv",
    }


def card(*words: object) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(run(*words, "--json").stdout)["card"]
    return found


def test_a_check_that_passes_says_what_it_would_have_seen(tools: dict[str, Path]) -> None:
    told = card("check", tools["ai"], tools["rests"], "--limit", "20mg")
    (worth,) = told["good_to"]
    assert worth["quantity"] == "see a change of bias"
    assert "limit 20 mg, as stated" in worth["detail"]
    assert told["found"][0].startswith("Nothing shows")
    assert "imucal apply" in told["to_do"][0]
    assert "imucal check" in told["command"]


def test_a_fleet_says_what_a_device_is_good_to(tmp_path: Path) -> None:
    tables = [SAMPLES / f"cave_{n}.csv" for n in ("ai", "bi", "fb")]
    out = tmp_path / "fleet"
    done = run("fleet", *tables, "--reference", "norm", "--only", "quadratic", "--draws", "99",
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
