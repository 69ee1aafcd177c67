"""What a finished run leaves behind: one document, one report.json, and files as one unit."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from imucalib.calibration.file import to_yaml, write_together
from imucalib.calibration.outcome import Run
from imucalib.exports import Exported
from imucalib.report.data import report_dict
from imucalib.report.document import Document
from imucalib.report.render.html import render_html


@dataclass(frozen=True)
class Report:
    """A run and its document; report.json's content is made once."""

    run: Run
    document: Document

    @cached_property
    def content(self) -> dict[str, Any]:
        return report_dict(self.run)


def write_report(
    report: Report, folder: Path, exported: Sequence[Exported] = ()
) -> tuple[Path, ...]:
    """Write calibration.yaml, report.json, report.html and exports into a folder, all or none;
    returns their paths."""
    content = json.dumps(report.content, indent=2, ensure_ascii=False, allow_nan=False)
    texts = {
        "calibration.yaml": to_yaml(report.run.calibration),
        "report.json": content + "\n",
        "report.html": render_html(report.document),
        **{one.file: one.text for one in exported},
    }
    write_together({folder / name: text for name, text in texts.items()})
    return tuple(folder / name for name in texts)
