"""The series of calibrations of one recording, as a section of the report."""

from __future__ import annotations

import numpy as np

from imucalib.calibrators.actigraph.observations import hours
from imucalib.calibrators.actigraph.series import Series as Calibrations
from imucalib.report.document import Block, Plot, Section, Series, Table, Text
from imucalib.significant_digits import plus_minus, probability


def series_section(found: Calibrations) -> Section:
    """Each part's parameters, and whether they differ."""
    good = [part for part in found.parts if part.fit is not None]
    words = (
        f"The {len(good)} calibrations differ (p {probability(found.p, 10**6)})"
        if found.differ
        else f"One calibration serves all {len(good)} parts (p {found.p:.2g} if nothing changed)"
    )
    moved = f": {', '.join(name for name, _ in found.moved)}" if found.moved else ""
    rows = []
    for part in found.parts:
        cells = (
            [
                plus_minus(float(v), float(s), "")
                for v, s in zip(part.fit.theta[:3], part.fit.sd[:3], strict=True)
            ]
            if part.fit is not None
            else [part.reason, "-", "-"]
        )
        rows.append((hours(part.start), str(part.runs), *cells))
    table = Table(
        "Bias by part (mg)", ("from", "runs", "x", "y", "z"), tuple(rows), "lrrrr",
        "`imucal apply` corrects each sample with "
        + ("the part valid at its time." if found.differ else "the calibration of the whole.")
        + " All parameters of the parts are in report.json.",
    )  # fmt: skip
    middle = np.array([0.5 * (p.start + p.stop) / 86400.0 for p in good])
    curves = tuple(
        Series(
            found.parameters[k].name,
            middle,
            np.array([p.fit.theta[k] - found.common[k] for p in good if p.fit]),
            "bars",
            np.array([p.fit.theta[k] - found.common[k] - 2.0 * p.fit.sd[k] for p in good if p.fit]),
            np.array([p.fit.theta[k] - found.common[k] + 2.0 * p.fit.sd[k] for p in good if p.fit]),
        )
        for k in range(3)
    )
    plot = Plot(
        "Bias over time", "time (d)", "change of bias (mg)", curves,
        "Change from what all parts have in common; whiskers: two standard deviations.",
    )  # fmt: skip
    blocks: tuple[Block, ...] = (
        Text(f"{words}{moved}.", "warning" if found.differ else "ok"), table, plot,
    )  # fmt: skip
    return Section("Recalibration over time", blocks)
