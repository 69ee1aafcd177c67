"""Options in a file."""

from __future__ import annotations

import json
from pathlib import Path

import click
import pytest
from click.testing import CliRunner, Result

from imucalib import cli
from worlds.places import SAMPLES

CAVE = SAMPLES / "cave_ai.csv"


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path / "imucal.toml"


def lab(*arguments: str) -> Result:
    words = ["lab", str(CAVE), "--json", "-q", *arguments]
    return CliRunner().invoke(cli.cli, words, standalone_mode=False)


def test_options_of_the_file_are_defaults_and_typed_ones_win(bench: Path) -> None:
    bench.write_text('[lab]\nreference = "norm"\nno-loop = true\ngravity = 9.81\n')
    refused = lab()
    assert isinstance(refused.exception, click.UsageError)  # loop = false is the name
    bench.write_text(
        '[lab]\nreference = "norm"\nloop = false\ngravity = 9.81\nexclude = "1,2"\n'
        '[actigraph]\nlatitude = 46.3\n'
    )  # fmt: skip
    settings = json.loads(lab().stdout)["provenance"]["settings"]
    assert settings["gravity_m_per_s2"] == 9.81
    assert settings["exclude"] == [1, 2]
    assert settings["loop"] is False
    typed = json.loads(lab("--gravity", "9.79").stdout)["provenance"]
    assert typed["settings"]["gravity_m_per_s2"] == 9.79


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[lab]\ngravty = 9.8\n", "'gravty' is no option of imucal lab"),
        ("gravity = 9.8\n", "stands in no section"),
        ("[labb]\ngravity = 9.8\n", "no command 'labb'"),
        ('[lab]\neffects = "own.py"\n', "'effects' must be typed"),
        ('[lab]\noutput = "out"\n', "'output' must be typed"),
        ("[lab\n", "imucal.toml"),
        ('[lab]\nreference = "norm"\ngravity = "much"\n', "much"),
    ],
)
def test_what_is_wrong_in_it_is_said(bench: Path, text: str, words: str) -> None:
    bench.write_text(text)
    done = lab()
    assert isinstance(done.exception, click.UsageError)
    assert words in done.exception.format_message()
