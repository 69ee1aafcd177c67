"""report.json of `actigraph`: the shared part and what only a worn sensor has."""

from __future__ import annotations

from typing import Any

from imucalib.calibrators.actigraph.calibration import (
    actigraph_calibration,
    coverage_block,
    data_share_block,
    error_block,
    sphere_block,
)
from imucalib.calibrators.actigraph.run import ActigraphRun
from imucalib.report.actigraph.series import series_block
from imucalib.report.data import report_dict


def actigraph_dict(run: ActigraphRun) -> dict[str, Any]:
    """Plain types, ready for JSON."""
    details: dict[str, Any] = {
        "error_mg": error_block(run),
        "coverage": coverage_block(run),
        "from_data": data_share_block(run),
        "sphere": sphere_block(run),
        "matrices": actigraph_calibration(run).matrices().as_dict(),
    }
    if run.series:
        details["series"] = series_block(run.series)
    return report_dict(run.outcome, details)
