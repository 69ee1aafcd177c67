"""The files of an actigraph run, each written whole or not at all; the YAML first."""

from __future__ import annotations

import json
from pathlib import Path

from imucalib.calibration.file import write, write_whole
from imucalib.calibrators.actigraph.calibration import actigraph_calibration
from imucalib.calibrators.actigraph.run import ActigraphRun
from imucalib.report.actigraph.data import actigraph_dict
from imucalib.report.actigraph.document import actigraph_document
from imucalib.report.render.html import render_html


def write_reports(run: ActigraphRun, folder: Path) -> tuple[Path, ...]:
    """Write calibration.yaml, report.json and report.html into a folder; returns their paths."""
    yaml, data, page = (folder / n for n in ("calibration.yaml", "report.json", "report.html"))
    write(actigraph_calibration(run), yaml)
    content = json.dumps(actigraph_dict(run), indent=2, ensure_ascii=False, allow_nan=False)
    write_whole(data, content + "\n")
    write_whole(page, render_html(actigraph_document(run)))
    return yaml, data, page
