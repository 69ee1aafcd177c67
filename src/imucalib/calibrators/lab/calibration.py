"""The calibration that a lab run writes, with the blocks that people read beside the numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from imucalib.calibration.ambiguity import KEY
from imucalib.calibration.calibration import Calibration, from_fit
from imucalib.calibration.outcome import Outcome
from imucalib.calibrators.lab.attitude import attitude_errors, rms, worst
from imucalib.calibrators.lab.bench import RawUnit
from imucalib.calibrators.lab.calibrate import LabResult
from imucalib.calibrators.lab.dial import dial_of
from imucalib.calibrators.lab.errors import reading_noise, setting_noise
from imucalib.calibrators.lab.faults import Faults
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.sessions.between import Sessions
from imucalib.calibrators.next_recording import recorded_block
from imucalib.core.fit import Fit
from imucalib.core.references import KnownVector
from imucalib.loop.held_out import errors
from imucalib.loop.separation import ambiguities
from imucalib.units import DEG, MG


def lab_calibration(
    outcome: Outcome,
    result: LabResult,
    raw: RawUnit,
    request: LabRequest,
    details: Mapping[str, Any],
) -> Calibration:
    """The calibration of a run's final fit, with the blocks that people read beside the numbers."""
    facts = {
        "gravity_source": request.gravity_source,
        "errors": [error.as_dict() for error in outcome.errors],
        "noise": details["noise"],
        "held_out": details["held_out"],
    }
    if "fixture" in details:
        facts["conventions"] = asdict(result.settings.conventions)
        facts["fixture"] = details["fixture"]
    if "between_sessions" in details:
        facts["between_sessions"] = details["between_sessions"]
    facts["left_out"] = details["left_out"]
    facts["provenance"] = outcome.provenance.as_dict()
    return from_fit(
        result.final,
        "lab",
        raw_unit=raw.name,
        raw_to_si=raw.si,
        gravity=request.gravity,
        status=outcome.status,
        reasons=(*outcome.reasons, *outcome.undecided),
        facts=facts,
    )


def lab_details(
    result: LabResult,
    excluded: tuple[str, ...],
    undecided: tuple[str, ...],
    faults: Faults,
    sessions: Sessions | None = None,
) -> dict[str, Any]:
    """What only a bench has to say, for report.json; the shorter blocks also for the YAML."""
    details: dict[str, Any] = {
        "noise": noise_block(result.final),
        "held_out": held_out_block(result),
        "left_out": list(excluded),
        "positions": _positions(result),
        "undecided": list(undecided),
        "faults": [asdict(fault) for fault in faults.slips],
    }
    if isinstance(result.observations.reference, KnownVector):
        details["fixture"] = fixture_block(result)
    if sessions:
        details["between_sessions"] = sessions_block(sessions)
    if result.loop is not None:
        fit = result.final
        # What neighbours share is noise of a later rest too.
        reading = reading_noise(fit).whole
        found = ambiguities(result.loop.final, result.loop.alternatives)
        details[KEY] = recorded_block(fit, found, reading=reading, settings=setting_noise(fit))
    return details


def sessions_block(sessions: Sessions) -> dict[str, Any]:
    """How much power-ups scatter, each session's own offset, and the next one's parameters."""
    scatter = [
        {
            "what": one.name,
            "unit": one.unit,
            "sd": one.sd,
            "low_95": one.interval[0],
            "high_95": one.interval[1],
            "offsets": one.offsets.tolist(),
            "offsets_sd": one.offsets_sd.tolist(),
        }
        for one in sessions.between
    ]
    following = [
        {
            "parameter": p.name,
            "unit": p.unit,
            "value": p.value,
            "sd_of_mean": p.mean,
            "sd_next_power_up": p.sd,
            "half_of_95": p.half,
        }
        for p in sessions.parameters
    ]
    return {"sessions": list(sessions.names), "scatter": scatter, "next_power_up": following}


def noise_block(fit: Fit) -> dict[str, Any]:
    """Noise of the readings (mg) and scatter of the settings (deg), with their sd."""
    noise = reading_noise(fit)
    block: dict[str, Any] = {"reading_mg": noise.own / MG, "reading_sd_mg": noise.own_sd / MG}
    for k, (name, sd) in enumerate(setting_noise(fit).items(), start=1):
        key = name.replace(" ", "_").replace("-", "_")
        block[f"{key}_deg"] = sd / DEG
        block[f"{key}_sd_deg"] = sd / DEG * float(fit.noise_sd[k])
    if noise.shared > 0.0:
        block |= {"shared_mg": noise.shared / MG, "shared_sd_mg": noise.shared_sd / MG}
        block["shared_memory_positions"] = noise.memory
    return block


def held_out_block(result: LabResult) -> list[dict[str, Any]]:
    """Errors on data that was not fitted, largest and rms, per split and model."""
    rows = []
    for split in result.splits:
        for name, held in (("base", split.base), ("final", split.final)):
            found = attitude_errors(held, result.settings.conventions)
            row: dict[str, Any] = {"split": split.name, "model": name, "positions": len(split.rows)}
            if isinstance(result.observations.reference, KnownVector):
                row |= {
                    "tool_face_deg": [worst(found.tool_face), rms(found.tool_face)],
                    "inclination_deg": [worst(found.inclination), rms(found.inclination)],
                }
            rows.append({**row, "norm_mg": [worst(found.norm), rms(found.norm)]})
    return rows


def fixture_block(result: LabResult) -> dict[str, Any]:
    """What the bench is off by: inclination against the dial with 95 % intervals."""
    fit = result.final
    effects = [e.name for e in fit.model.effects if e.stage == "fixture"]
    at = np.array([0.0, 30.0, 50.0, 60.0, 90.0])
    dial = dial_of(result, at)
    curve = [
        {
            "inclination_deg": float(a),
            "true_minus_dial_deg": float(s),
            "sd_deg": float(d),
            "low_95_deg": float(s - h),
            "high_95_deg": float(s + h),
        }
        for a, s, d, h in zip(at, dial.shift, dial.sd, dial.half, strict=True)
    ]
    return {"effects": effects, "inclination": curve if effects else []}


def _positions(result: LabResult) -> list[dict[str, Any]]:
    fit, whole = result.final, result.observations
    known = isinstance(whole.reference, KnownVector)
    held = errors(fit, fit.theta, whole)
    angle = attitude_errors(held, result.settings.conventions)
    used = set(result.used.tolist())
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
