"""The report of the paper's own procedure: its methods beside each other, verified."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from imucalib.calibrators.actigraph.published import PublishedRun
from imucalib.report.card import card_of, error_worth
from imucalib.report.document import Document, Section, Table
from imucalib.report.loop import TERMS
from imucalib.report.sections import parameter_table, verdict


def published_document(run: PublishedRun) -> Document:
    """Methods, parameters and points."""
    error = run.outcome.error
    head = (
        f"Mean error {error.held_out.raw:.2f} mg before, {error.held_out.final:.2f} mg after, on "
        f"{len(run.control)} points that were not used (paper 002, Table 3)."
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
    note = "sd from the residual of the points; 18 points leave 9 degrees of freedom."
    parameters = parameter_table(run.calibration, note)
    points = tuple(
        (f"{k + 1}", *(f"{v:+.4f}" for v in point)) for k, point in enumerate(run.points)
    )
    return Document(
        f"Calibration of {Path(run.scanned.path).name} as published",
        verdict(run.outcome, head),
        (
            Section("Methods", (methods,)),
            Section("Parameters", (parameters,)),
            Section("Points", (Table("Points (g)", ("", "x", "y", "z"), points, "lrrr"),),
                    brief=False),
        ),
        run.outcome.provenance.footer,
        card_of(run.outcome, (error_worth(error, "|a| at rest", "points"),)),
        TERMS,
    )  # fmt: skip


def _number(value: float, places: int = 2) -> str:
    return "-" if np.isnan(value) else f"{value:.{places}f}"
