"""Draw docs/images/report.png, the first report that the README writes; needs Chromium.

python docs/picture.py [CHROMIUM]
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from examples import PAGES, ROOT, bench, examples, run

_QUIET = (
    "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--hide-scrollbars",
    "--window-size=860,1560", "--force-device-scale-factor=1",
)  # fmt: skip


def main(browser: str = "chromium") -> None:
    """Run the command, open its report, keep the head of the page."""
    readme = PAGES[0]
    shown = (e for e in examples(readme.read_text(encoding="utf-8")) if e.shown is not None)
    example = next(e for e in shown if "-o" in e.arguments)
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as profile:
        with bench(Path(folder), readme):
            run(example)
        page = Path(folder) / example.arguments[example.arguments.index("-o") + 1] / "report.html"
        picture = ROOT / "docs" / "images" / "report.png"
        command = [browser, *_QUIET, f"--user-data-dir={profile}", f"--screenshot={picture}"]
        subprocess.run([*command, page.as_uri()], check=True, capture_output=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
