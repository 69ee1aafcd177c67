"""report.json of `lab`: the shared part and what only a bench has."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from imucalib.calibrators.lab.attitude import attitude_errors
from imucalib.calibrators.lab.calibrate import gravity_of
from imucalib.calibrators.lab.calibration import (
    fixture_block,
    held_out_block,
    lab_calibration,
    noise_block,
)
from imucalib.calibrators.lab.run import LabRun
from imucalib.core.references import KnownVector
from imucalib.loop.held_out import errors
from imucalib.report.data import report_dict
from imucalib.units import MG


def lab_dict(run: LabRun) -> dict[str, Any]:
    """Plain types, ready for JSON."""
    known = isinstance(run.result.observations.reference, KnownVector)
    details: dict[str, Any] = {
        "noise": noise_block(run),
        "held_out": held_out_block(run),
        "matrices": lab_calibration(run).matrices().as_dict(),
        "left_out": list(run.excluded),
        "positions": _positions(run, known),
        "undecided": list(run.outcome.undecided),
        "faults": [asdict(fault) for fault in run.faults.slips],
    }
    if known:
        details["fixture"] = fixture_block(run)
    return report_dict(run.outcome, details)


def _positions(run: LabRun, known: bool) -> list[dict[str, Any]]:
    fit, whole = run.result.final, run.result.observations
    held = errors(fit, fit.theta, whole)
    angle = attitude_errors(held, gravity_of(whole))
    used = set(run.result.used.tolist())
    rows = []
    for k, label in enumerate(whole.label):
        row: dict[str, Any] = {
            "position": label,
            "fitted": k in used,
            "corrected_m_per_s2": held.corrected[k, 0].tolist(),
            "norm_error_mg": float(angle.norm[k]),
        }
        if known:
            row |= {
                "error_mg": (held.error[k, 0] / MG).tolist(),
                "inclination_error_deg": float(angle.inclination[k]),
                "tool_face_error_deg": float(angle.tool_face[k]),
            }
        rows.append(row)
    return rows
