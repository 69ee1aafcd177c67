"""Draw docs/images/report.png, the first report that the README writes; needs Chromium.

The words that the picture shows stand in it as PNG text, for those who cannot see it, and for the
test that holds them against the README.

python docs/picture.py [CHROMIUM]
"""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import tempfile
import zlib
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
        card = json.loads(page.with_suffix(".json").read_text(encoding="utf-8"))["card"]
        said = [f"{w['quantity']} {w['value']}" for w in card["good_to"]] + card["found"]
        picture.write_bytes(described(picture.read_bytes(), "\n".join(said)))


#: Signature and header of a PNG file; its text comes next.
_HEADER = 8 + 25


def described(png: bytes, text: str) -> bytes:
    """The picture with its description as international text (PNG, third edition, 11.3.3.4)."""
    chunk = b"iTXt" + b"Description\0\0\0\0\0" + text.encode()
    whole = struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
    return png[:_HEADER] + whole + png[_HEADER:]


def description(png: bytes) -> str:
    """What `described` wrote; KeyError where there is none."""
    if png[_HEADER + 4 : _HEADER + 8] != b"iTXt":
        raise KeyError("the picture has no description: make docs")
    (length,) = struct.unpack(">I", png[_HEADER : _HEADER + 4])
    return png[_HEADER + 8 + 16 : _HEADER + 8 + length].decode()


if __name__ == "__main__":
    main(*sys.argv[1:])
