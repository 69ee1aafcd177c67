"""What the site holds: every page at the place that it has in the clone, and what pages link to."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
#: Pages outside of docs/.
OTHERS = ("README.md", "CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md", "VISION.md",
          "sample_logs/README.md", "benchmarks/RESULTS.md")  # fmt: skip
_LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)\s]*)?\)")
_FENCED = re.compile(r"^```.*?^```$|`[^`\n]*`", re.DOTALL | re.MULTILINE)


def pages() -> list[Path]:
    """Every page."""
    return [*(ROOT / name for name in OTHERS), *sorted((ROOT / "docs").rglob("*.md"))]


def links(page: Path) -> Iterator[str]:
    """Targets within the clone that a page names outside of code."""
    for target in _LINK.findall(_FENCED.sub("", page.read_text(encoding="utf-8"))):
        if not target.startswith(("http:", "https:", "mailto:")):
            yield target


def linked(known: list[Path]) -> set[Path]:
    """Files that are no pages and to which pages link; a folder has none of its own."""
    found = {(page.parent / target).resolve() for page in known for target in links(page)}
    return {path for path in found if path.is_file() and path not in set(known)}


def on_files(files: Any, config: Any) -> Any:
    """The same under docs/ in the place of what lies in docs/, the other pages, and their files."""
    from mkdocs.structure.files import File, Files

    known = pages()
    own = [f for f in files if Path(str(f.abs_src_path)).is_relative_to(config.docs_dir)]
    kept = [f for f in files if f not in own]
    made = [
        File(
            path.relative_to(ROOT).as_posix(), str(ROOT), config.site_dir, config.use_directory_urls
        )
        for path in (*known, *sorted(linked(known)), *sorted(Path(__file__).parent.glob("*.css")))
    ]
    return Files([*kept, *made])
