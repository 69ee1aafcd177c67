"""The pages: every link leads to what is there, and README and the site's menu name every page."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from options.tree import commands, options_of
from worlds.places import ROOT, script

site = script("docs/site/pages.py")

_FENCED = re.compile(r"^```.*?^```$", re.DOTALL | re.MULTILINE)


def anchors(page: Path) -> set[str]:
    """Of every heading, as GitHub and the site both make them of these pages' words."""
    text = _FENCED.sub("", page.read_text(encoding="utf-8"))
    found = set()
    for title in re.findall(r"^#+ (.+)$", text, flags=re.MULTILINE):
        words = re.sub(r"[^\w\s-]", "", title.replace("\\", "").lower())
        found.add(re.sub(r"\s", "-", words.strip()))
    return found


@pytest.mark.parametrize("page", site.pages(), ids=lambda p: p.relative_to(ROOT).as_posix())
def test_every_link_leads_somewhere(page: Path) -> None:
    for target in site.links(page):
        assert (page.parent / target).exists(), target
    text = _FENCED.sub("", page.read_text(encoding="utf-8"))
    for target, anchor in re.findall(r"\]\(([^)#\s]*)#([^)\s]+)\)", text):
        if not target.startswith("http"):
            assert anchor in anchors(page.parent / target if target else page), f"{target}#{anchor}"


def test_the_menu_names_every_page_once() -> None:
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    named = re.findall(
        r"^ +- [^:\n]+: (\S+\.md)$", text[text.index("\nnav:") :], flags=re.MULTILINE
    )
    assert sorted(named) == sorted(p.relative_to(ROOT).as_posix() for p in site.pages())


def test_readme_names_every_page() -> None:
    named = {(ROOT / target).resolve() for target in site.links(ROOT / "README.md")}
    missing = {p for p in site.pages() if p not in named} - {ROOT / "README.md", ROOT / "VISION.md"}
    assert not missing


def test_the_reference_has_every_option_of_every_command() -> None:
    page = (ROOT / "docs" / "reference" / "commands.md").read_text(encoding="utf-8")
    for name, command in commands().items():
        heading = re.search(rf"^#+ imucal {name}$", page, flags=re.MULTILINE)
        assert heading, name
        following = re.search(r"^#+ imucal ", page[heading.end() :], flags=re.MULTILINE)
        part = page[heading.end() :][: following.start() if following else None]
        for option in options_of(command):
            assert f"`{option}`" in part, f"{name} {option}"


def test_no_page_holds_a_place_that_was_to_be_filled() -> None:
    for page in site.pages():
        text = _FENCED.sub("", page.read_text(encoding="utf-8"))
        assert not re.findall(
            r"^[A-Z][A-Z_]+_[A-Z_]+$|\bTODO\b|\bTBD\b", text, flags=re.MULTILINE
        ), page


def test_the_site_is_built_by_make_and_by_the_workflow() -> None:
    rule = re.search(r"^site:.*\n\t(.*)$", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)
    assert rule
    assert "mkdocs build --strict" in rule[1]
    assert "make site" in (ROOT / ".github/workflows/ci.yml").read_text()


def test_the_benchmarks_page_names_what_is_there() -> None:
    """Every script that it names exists, and every one that is called by itself is named."""
    folder = ROOT / "benchmarks"
    text = (folder / "README.md").read_text(encoding="utf-8")
    here = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*.py")}
    named = set(re.findall(r"`([\w/]+\.py)`", text))
    whole = tuple(re.findall(r"`([\w/]+/)`", text))
    called = {name for name, path in here.items() if "__main__" in path.read_text(encoding="utf-8")}
    assert named <= set(here)
    assert {name for name in called if not name.startswith(whole)} <= named


def test_the_picture_shows_what_the_readme_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    said = script("docs/picture.py").description((ROOT / "docs/images/report.png").read_bytes())
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    for line in said.splitlines():
        assert " ".join(line.split()) in readme
