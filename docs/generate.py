"""Write the pages that come from the code, or with --check say which are stale.

--outputs also runs the commands whose output a page shows (a minute), and fills it in.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from generators import commands, functions, rooms, schemas
from imucalib.effects import catalogue, families
from imucalib.report.catalogue import catalogue_markdown

HERE = Path(__file__).parent


PAGES = {
    "DESIGN.md": rooms.page,
    "effects.md": lambda: catalogue_markdown(list(catalogue().values()), list(families().values())),
    "reference/commands.md": commands.page,
    "reference/functions.md": functions.page,
    "reference/schemas.md": schemas.page,
}


def main() -> int:
    """Write or compare; the exit code says whether anything is stale."""
    made = {HERE / name: make().rstrip() + "\n" for name, make in PAGES.items()}
    made |= {schemas.FOLDER / name: text + "\n" for name, text in schemas.files().items()}
    if "--outputs" in sys.argv:
        made |= outputs()
    stale = []
    for page, text in made.items():
        if "--check" in sys.argv:
            if not page.is_file() or page.read_text(encoding="utf-8") != text:
                stale.append(page.name)
        else:
            page.write_text(text, encoding="utf-8")
    if stale:
        print(f"stale: {', '.join(stale)}; run make docs", file=sys.stderr)
    return 1 if stale else 0


def outputs() -> dict[Path, str]:
    """Every page that shows what the program prints."""
    from examples import PAGES as SHOWING
    from examples import examples, filled

    made = {}
    for page in SHOWING:
        if any(e.shown is not None for e in examples(page.read_text(encoding="utf-8"))):
            with tempfile.TemporaryDirectory() as folder:
                made[page] = filled(page, Path(folder))
    return made


if __name__ == "__main__":
    sys.exit(main())
