"""The report of the paper's own procedure: its methods beside each other, verified."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from imucalib.calibration.file import write, write_whole
from imucalib.calibrators.actigraph.published import (
    PublishedRun,
    method_block,
    published_calibration,
)
from imucalib.report.data import report_dict
from imucalib.report.document import Document, Section, Table, Text
from imucalib.report.render.html import render_html
from imucalib.significant_digits import with_sd

_TONE = {"ok": "ok", "marginal": "warning", "failed": "bad"}


def published_document(run: PublishedRun) -> Document:
    """Methods, parameters and points."""
    error = run.outcome.error
    verdict = Text(
        f"Mean error {error.held_out.raw:.2f} mg before, {error.held_out.final:.2f} mg after, on "
        f"{len(run.control)} points that were not used (paper 002, Table 3).",
        "ok" if run.outcome.status == "ok" else "warning",
    )
    rows = tuple(
        (m.name, f"{m.fitted:.2f}", _number(m.verified), _number(m.improvement, 0))
        for m in run.methods
    )
    methods = Table(
        "The paper's methods on the same 18 points",
        ("method", "fitted, mg", "second set, mg", "R, %"),
        rows,
        "lrrr",
        "Fixed point: operands of 32 or 16 bits, products of twice as many, no square root.",
    )
    fit = run.outcome.fit
    values = tuple(
        (p.name, *with_sd(float(v), float(s)), p.unit)
        for p, v, s in zip(fit.parameters, fit.theta, fit.sd, strict=True)
    )
    note = "sd from the residual of the points; 18 points leave 9 degrees of freedom."
    parameters = Table("Parameters", ("parameter", "value", "sd", "unit"), values, "lrrl", note)
    points = tuple(
        (f"{k + 1}", *(f"{v:+.4f}" for v in point)) for k, point in enumerate(run.points)
    )
    return Document(
        f"Calibration of {Path(run.scanned.path).name} as published",
        verdict,
        (
            Section("Methods", (methods,)),
            Section("Parameters", (parameters,)),
            Section("Points", (Table("Points (g)", ("", "x", "y", "z"), points, "lrrr"),),
                    brief=False),
        ),
    )  # fmt: skip


def _number(value: float, places: int = 2) -> str:
    return "-" if np.isnan(value) else f"{value:.{places}f}"


def published_dict(run: PublishedRun) -> dict[str, object]:
    """Plain types, ready for JSON."""
    details = {
        "methods": {m.name: method_block(m) for m in run.methods},
        "points_g": run.points.tolist(),
        "control_points_g": run.control.tolist(),
    }
    return report_dict(run.outcome, details)


def write_published(run: PublishedRun, folder: Path) -> tuple[Path, ...]:
    """Write calibration.yaml, report.json and report.html into a folder; returns their paths."""
    yaml, data, page = (folder / n for n in ("calibration.yaml", "report.json", "report.html"))
    write(published_calibration(run), yaml)
    content = json.dumps(published_dict(run), indent=2, ensure_ascii=False, allow_nan=False)
    write_whole(data, content + "\n")
    write_whole(page, render_html(published_document(run)))
    return yaml, data, page
