"""`imucal design -o` writes a table that it reads back."""

from __future__ import annotations

import json
from pathlib import Path

from click.testing import CliRunner

from imucalib import cli


def design(*arguments: object) -> str:
    words = ["design", *(str(a) for a in arguments), "--json"]
    return CliRunner().invoke(cli.cli, words, standalone_mode=False, catch_exceptions=False).stdout


def test_a_recommended_plan_is_judged_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "plan.csv"
    made = json.loads(design("--recommend", 12, "-o", path))
    read = json.loads(design(path))
    assert read["positions"] == [
        {k: round(v, 1) for k, v in p.items()} for p in made["positions"]
    ]  # fmt: skip
    assert abs(read["norm_only"]["efficiency"] - made["norm_only"]["efficiency"]) < 1e-3
