"""The three files of a lab run, each written whole or not at all; the YAML first."""

from __future__ import annotations

import json
from pathlib import Path

from imucalib.calibration.file import write, write_whole
from imucalib.calibrators.lab.calibration import lab_calibration
from imucalib.calibrators.lab.run import LabRun
from imucalib.report.lab.data import lab_dict
from imucalib.report.lab.document import lab_document
from imucalib.report.render.html import render_html


def write_reports(run: LabRun, folder: Path) -> tuple[Path, ...]:
    """Write calibration.yaml, report.json and report.html into a folder; returns their paths."""
    yaml, data, page = (folder / n for n in ("calibration.yaml", "report.json", "report.html"))
    write(lab_calibration(run), yaml)
    content = json.dumps(lab_dict(run), indent=2, ensure_ascii=False, allow_nan=False)
    write_whole(data, content + "\n")
    write_whole(page, render_html(lab_document(run)))
    return yaml, data, page
