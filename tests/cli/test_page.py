"""What a calibration prints: one page, or with --full all; JSON holds the card and figures."""

from __future__ import annotations

import pytest
from click.testing import CliRunner, Result

from imucalib import cli
from worlds.places import SAMPLES


def lab(*arguments: str) -> Result:
    words = ["lab", str(SAMPLES / "cave_ai.csv"), "--reference", "norm", "--no-loop", *arguments]
    return CliRunner().invoke(cli.cli, words, standalone_mode=False, catch_exceptions=False)


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
