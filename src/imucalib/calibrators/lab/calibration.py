"""The calibration that a lab run writes, with the blocks that people read beside the numbers."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from imucalib.calibration.calibration import Calibration, from_fit
from imucalib.calibrators.lab.advice import fixture_curve
from imucalib.calibrators.lab.attitude import attitude_errors, rms, worst
from imucalib.calibrators.lab.calibrate import gravity_of
from imucalib.calibrators.lab.errors import setting_noise
from imucalib.calibrators.lab.run import LabRun
from imucalib.core.references import KnownVector
from imucalib.units import DEG, MG


def lab_calibration(run: LabRun) -> Calibration:
    """The calibration of a run's final fit."""
    outcome = run.outcome
    return from_fit(
        run.result.final,
        "lab",
        raw_unit=run.raw.name,
        raw_to_si=run.raw.si,
        gravity=run.request.gravity,
        status=outcome.status,
        reasons=(*outcome.reasons, *outcome.undecided),
        facts=_facts(run),
    )


def _facts(run: LabRun) -> dict[str, Any]:
    origin, fit = run.outcome.provenance, run.result.final
    facts: dict[str, Any] = {
        "gravity_source": run.request.gravity_source,
        "noise": noise_block(run),
        "held_out": held_out_block(run),
    }
    if isinstance(fit.observations.reference, KnownVector):
        facts["conventions"] = asdict(run.request.settings.conventions)
        facts["fixture"] = fixture_block(run)
    facts["provenance"] = {
        "input": origin.path,
        "sha256": origin.sha256,
        "positions": origin.samples,
        "used": len(run.result.used),
        "left_out": list(run.excluded),
        "mapping": {k: _plain(v) for k, v in origin.mapping.items()},
        "settings": {k: _plain(v) for k, v in origin.settings.items()},
        "seed": origin.seed,
        "versions": dict(origin.versions),
        "time": origin.time,
    }
    return facts


def _plain(value: object) -> Any:
    return list(value) if isinstance(value, tuple) else value


def noise_block(run: LabRun) -> dict[str, Any]:
    """Noise of the readings (mg) and scatter of the settings (deg), with their sd."""
    fit = run.result.final
    sigma = fit.noise.factor * float(np.median(fit.at.sigma)) / MG
    block: dict[str, Any] = {"reading_mg": sigma, "reading_sd_mg": sigma * float(fit.noise_sd[0])}
    for k, (name, sd) in enumerate(setting_noise(fit.noise).items(), start=1):
        key = name.replace(" ", "_").replace("-", "_")
        block[f"{key}_deg"] = sd / DEG
        block[f"{key}_sd_deg"] = sd / DEG * float(fit.noise_sd[k])
    return block


def held_out_block(run: LabRun) -> list[dict[str, Any]]:
    """Errors on data that was not fitted, largest and rms, per split and model."""
    gravity = gravity_of(run.result.observations)
    rows = []
    for split in run.result.splits:
        for name, held in (("base", split.base), ("final", split.final)):
            errors = attitude_errors(held, gravity)
            row: dict[str, Any] = {"split": split.name, "model": name, "positions": len(split.rows)}
            if isinstance(run.result.observations.reference, KnownVector):
                row |= {
                    "tool_face_deg": [worst(errors.tool_face), rms(errors.tool_face)],
                    "inclination_deg": [worst(errors.inclination), rms(errors.inclination)],
                }
            rows.append({**row, "norm_mg": [worst(errors.norm), rms(errors.norm)]})
    return rows


def fixture_block(run: LabRun) -> dict[str, Any]:
    """What the bench is off by: inclination against the dial with 95 % intervals."""
    fit = run.result.final
    effects = [e.name for e in fit.model.effects if e.stage == "fixture"]
    at = np.radians([0.0, 30.0, 50.0, 60.0, 90.0])
    shift, sd, half = fixture_curve(fit, at)
    curve = [
        {
            "inclination_deg": round(float(a / DEG), 6),
            "true_minus_dial_deg": float(s),
            "sd_deg": float(d),
            "low_95_deg": float(s - h),
            "high_95_deg": float(s + h),
        }
        for a, s, d, h in zip(at, shift, sd, half, strict=True)
    ]
    return {"effects": effects, "inclination": curve if effects else []}
