"""Draw docs/images: report.png, the first report that the README writes, and residuals.png, what
each calibrator left of the error in its sample log; needs Chromium.

The words that the picture shows stand in it as PNG text, for those who cannot see it, and for the
test that holds them against the README.

python docs/picture.py [CHROMIUM]
"""

from __future__ import annotations

import json
import re
import struct
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

from examples import PAGES, ROOT, Example, bench, examples, run

_QUIET = (
    "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--hide-scrollbars",
    "--force-device-scale-factor=1",
)  # fmt: skip


def main(browser: str = "chromium") -> None:
    """Run the README's commands that calibrate, open their reports, keep what is shown."""
    readme = PAGES[0]
    every = examples(readme.read_text(encoding="utf-8"))
    calls = {e.arguments[0]: e for e in every if e.arguments[0] in _FIGURES and "-o" in e.arguments}
    first = next(e for e in every if e.shown is not None and "-o" in e.arguments)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        with bench(folder, readme):
            for one in {id(e): e for e in (first, *calls.values())}.values():
                run(one)
        reports = {name: _report(one, folder) for name, one in {**calls, "lab": first}.items()}
        card = json.loads(reports["lab"].with_suffix(".json").read_text(encoding="utf-8"))["card"]
        said = [f"{w['quantity']} {w['value']}" for w in card["good_to"]] + card["found"]
        _draw(reports["lab"], "report.png", (860, 1560), said, browser)
        drawn = {name: _figure(reports[name], name, title) for name, title in _FIGURES.items()}
        page = folder / "residuals.html"
        page.write_text(_PAGE + "".join(drawn[n] for n in _FIGURES), encoding="utf-8")
        _draw(page, "residuals.png", (1240, 736), list(_FIGURES.values()), browser)


#: Calibrator -> the title of the figure that has the error before and after.
_FIGURES = {
    "lab": "Error of inclination against inclination",
    "actigraph": "Error of |a| raw and corrected",
    "imu": "Gravity after a turn",
    "array": "Gyro residual against the rate",
}
_PAGE = """<!DOCTYPE html><meta charset="utf-8"><style>
body{margin:0;padding:8px;background:#fff;display:grid;grid-template-columns:1fr 1fr;gap:12px;
font:15px sans-serif}
figure{margin:0}svg{width:100%;height:auto}</style>"""


def _report(example: Example, folder: Path) -> Path:
    return folder / example.arguments[example.arguments.index("-o") + 1] / "report.html"


def _figure(report: Path, calibrator: str, title: str) -> str:
    """The first figure of a title in a report, with the calibrator's name. StopIteration where
    there is none."""
    page, label = report.read_text(encoding="utf-8"), f'aria-label="{title}'
    svg = next(s for s in re.findall(r"<svg .*?</svg>", page, re.S) if label in s)
    return f"<figure>imucal {calibrator}: {title}{svg}</figure>"


def _draw(page: Path, name: str, size: tuple[int, int], said: list[str], browser: str) -> None:
    picture = ROOT / "docs" / "images" / name
    with tempfile.TemporaryDirectory() as profile:
        command = [browser, *_QUIET, "--window-size={},{}".format(*size)]
        command += [f"--user-data-dir={profile}", f"--screenshot={picture}", page.as_uri()]
        subprocess.run(command, check=True, capture_output=True)
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
