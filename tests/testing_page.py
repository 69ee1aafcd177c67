"""docs/testing.md: its tables are written by the commands that measure them."""

from __future__ import annotations

from pathlib import Path

PAGE = Path(__file__).parents[1] / "docs" / "testing.md"


def _marks(name: str) -> tuple[str, str]:
    return f"<!-- {name} -->\n", f"<!-- end of {name} -->\n"


def filled(name: str, text: str) -> str:
    """The page with a text between the marks of a name. ValueError where there are none."""
    page, (first, last) = PAGE.read_text(encoding="utf-8"), _marks(name)
    start, stop = page.index(first) + len(first), page.index(last)
    return page[:start] + "\n" + text.strip() + "\n\n" + page[stop:]


def written(name: str, text: str) -> None:
    """Write `filled`."""
    PAGE.write_text(filled(name, text), encoding="utf-8")
