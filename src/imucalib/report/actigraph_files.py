"""The files of an actigraph run, each written whole or not at all; the YAML first."""

from __future__ import annotations

import json
from pathlib import Path

from imucalib.calibration import Calibration
from imucalib.calibration_file import write, write_whole
from imucalib.calibrators.actigraph_calibration import actigraph_calibration
from imucalib.calibrators.actigraph_export import EXPORTS
from imucalib.calibrators.actigraph_run import ActigraphRun
from imucalib.report.actigraph import actigraph_document
from imucalib.report.actigraph_data import actigraph_dict
from imucalib.report.html import render_html


def write_exports(
    calibration: Calibration, source: Path, formats: tuple[str, ...], folder: Path
) -> tuple[Path, ...]:
    """Write the coefficients in the formats of others; returns the paths."""
    paths = []
    for name in formats:
        file, make = EXPORTS[name]
        write_whole(folder / file, make(calibration, source.name))
        paths.append(folder / file)
    return tuple(paths)


def write_reports(run: ActigraphRun, folder: Path) -> tuple[Path, ...]:
    """Write calibration.yaml, report.json and report.html into a folder; returns their paths."""
    yaml, data, page = (folder / n for n in ("calibration.yaml", "report.json", "report.html"))
    write(actigraph_calibration(run), yaml)
    content = json.dumps(actigraph_dict(run), indent=2, ensure_ascii=False, allow_nan=False)
    write_whole(data, content + "\n")
    write_whole(page, render_html(actigraph_document(run)))
    return yaml, data, page
