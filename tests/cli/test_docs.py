"""The documentation is what the program does: generated pages, commands, the README's output."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest
from click.testing import CliRunner

from imucalib import cli
from imucalib.effects import catalogue
from worlds.places import ROOT


def test_generated_pages_are_current() -> None:
    command = [sys.executable, str(ROOT / "docs" / "generate.py"), "--check"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_every_command_is_in_the_readme_or_its_pages() -> None:
    text = "\n".join(
        p.read_text(encoding="utf-8") for p in (ROOT / "README.md", *ROOT.glob("docs/*.md"))
    )
    for name in cli.COMMANDS:
        assert f"`{name}`" in text or f"imucal {name}" in text


@pytest.mark.parametrize("name", list(cli.COMMANDS))
def test_every_help_shows_an_example(name: str) -> None:
    result = CliRunner().invoke(cli.cli, [name, "--help"])
    assert result.exit_code == 0
    assert re.search(r"Examples?:\s+imucal " + name, result.output)


def test_the_readmes_output_is_real() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = readme.split("$ imucal lab sample_logs/bench.csv -o out\n")[1].split("```")[0]
    arguments = ["lab", str(ROOT / "sample_logs" / "bench.csv")]
    result = CliRunner().invoke(cli.cli, arguments, standalone_mode=False)
    assert shown in result.stdout


def test_links_lead_somewhere() -> None:
    for page in (ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("sample_logs/*.md")):
        for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
            if not target.startswith("http"):
                assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_effects_named_in_the_documentation_exist() -> None:
    text = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^## (\w+)$", text, flags=re.M)) == set(catalogue())
