"""Write the pages that come from the code, or with --check say which are stale."""

from __future__ import annotations

import sys
from pathlib import Path

from imucalib.effects import catalogue
from imucalib.report.catalogue import catalogue_markdown

HERE = Path(__file__).parent


PAGES = {
    "effects.md": lambda: catalogue_markdown(list(catalogue().values())),
}


def main() -> int:
    """Write or compare; the exit code says whether anything is stale."""
    stale = []
    for name, make in PAGES.items():
        text = make().rstrip() + "\n"
        page = HERE / name
        if "--check" in sys.argv:
            if not page.is_file() or page.read_text(encoding="utf-8") != text:
                stale.append(name)
        else:
            page.write_text(text, encoding="utf-8")
    if stale:
        print(f"stale: {', '.join(stale)}; run make docs", file=sys.stderr)
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())
