"""What a finished run leaves behind: one document, one report.json, and files as one unit."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from imucalib.calibration.file import to_yaml, write_together
from imucalib.calibration.outcome import Run
from imucalib.errors import ImucalError, UsageError
from imucalib.exports import Exported
from imucalib.recording.yaml_text import load
from imucalib.report.data import report_dict, shown_dict
from imucalib.report.document import Document
from imucalib.report.render.html import render_html


@dataclass(frozen=True)
class Report:
    """A run and its document; report.json's content is made once."""

    run: Run
    document: Document

    @cached_property
    def content(self) -> dict[str, Any]:
        return {**report_dict(self.run), **shown_dict(self.document)}


def demand_folder(folder: Path, inputs: Sequence[Path]) -> None:
    """Raise UsageError unless results of `inputs` may be written into a folder; before the work.

    Results of a run on one of the inputs may be replaced; another's, or what no run wrote, may not.
    """
    place = next(p for p in (folder, *folder.parents) if p.exists())
    if not place.is_dir() or not os.access(place, os.W_OK | os.X_OK):
        what = "no folder can be written here" if place.is_dir() else "this is a file, no folder"
        raise UsageError(what, where=str(place), remedy="name another folder with -o")
    target = folder / "calibration.yaml"
    if not os.path.lexists(target):
        return
    try:
        facts = load(target)
        made = facts["provenance"]["input"]
    except (ImucalError, KeyError, TypeError):
        made = None
    if made not in {path.name for path in inputs}:
        held = f"the calibration of {made}" if made else "a file that is no calibration of imucal"
        raise UsageError(
            f"it holds {held}", where=str(target), remedy="name another folder, or give --force"
        )


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
