"""The control chart: what every calibration makes of one attitude, with its sd and the limit."""

from __future__ import annotations

import numpy as np

from imucalib.calibration.comparison.compare import Comparison
from imucalib.report.document import Plot, Series

_HALF = 1.959964


def control_chart(found: Comparison) -> Plot | None:
    """Size of the corrected force at the attitude where the calibrations differ most, against time
    or their order; None where no force was compared."""
    force = next((m for m in found.meanings if m.worst.unit == "mg"), None)
    if force is None:
        return None
    seen = found.seen[force.sensor]
    at = int(np.argmax(seen.attitude @ force.worst.attitude))
    value, sd = seen.size[:, at], seen.size_sd[:, at]
    weight = 1.0 / sd**2
    middle = float(weight @ value / weight.sum())
    days = None if found.drift is None else found.drift.dates.days
    x = np.arange(1.0, len(value) + 1.0) if days is None else days
    ends = np.array([x.min(), x.max()])
    level = np.full(2, middle)
    series = [
        Series("limit about the mean", ends, level, "band", level - force.limit,
               level + force.limit),
        Series("mean", ends, level, "line"),
        Series("calibrations, 95 %", x, value, "points", value - _HALF * sd, value + _HALF * sd,
               names=found.names),
    ]  # fmt: skip
    where = ", ".join(f"{v:+.2f}" for v in force.worst.attitude)
    return Plot(
        "Control chart" + (f" of {force.sensor}" if force.sensor else ""),
        "calibration" if days is None else "days since the first",
        "|f| against the first, mg",
        tuple(series),
        f"The attitude that differs most, force along ({where}): points outside the band have left "
        "the limit about the mean of all; whiskers are 95 % by what each calibration states.",
    )
