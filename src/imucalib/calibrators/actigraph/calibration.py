"""The calibration that an actigraph run writes, and the blocks that people read beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from imucalib.calibration import sums
from imucalib.calibration.ambiguity import KEY
from imucalib.calibration.calibration import Calibration, from_fit
from imucalib.calibration.outcome import Outcome
from imucalib.calibration.series import series_facts
from imucalib.calibrators.actigraph.calibrate import ActigraphResult
from imucalib.calibrators.actigraph.coverage import Coverage
from imucalib.calibrators.actigraph.errors import sphere_cells
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.actigraph.series import Series, series_block
from imucalib.calibrators.actigraph.weak import from_data
from imucalib.calibrators.next_recording import recorded_block
from imucalib.core.fit import Fit
from imucalib.core.sphere import counted
from imucalib.rests.runs import Scan
from imucalib.units import MG


def actigraph_calibration(
    outcome: Outcome,
    result: ActigraphResult,
    scanned: Scan,
    request: ActigraphRequest,
    details: Mapping[str, Any],
    parts: Series | None,
) -> Calibration:
    """The calibration of a run's final fit."""
    facts: dict[str, Any] = {
        "gravity_source": request.gravity_source,
        "frame": "x keeps its direction; gravity alone cannot see a rotation of the frame",
        "clock": {"start_ns": scanned.start_ns, "span_s": max(scanned.stop, 1.0)},
        "errors": [error.as_dict() for error in outcome.errors],
        "error_mg": details["error_mg"],
        "noise": _noise_block(result.final),
        "coverage": details["coverage"],
        "postures": counted(result.final.observations.reading[:, 0]).tolist(),
        "from_data": details["from_data"],
        "provenance": outcome.provenance.as_dict(),
    }
    whole = from_fit(
        result.final,
        "actigraph",
        raw_unit="m/s2",
        raw_to_si=1.0,
        gravity=request.gravity,
        status=outcome.status,
        reasons=outcome.reasons,
        facts=facts,
    )
    if parts is None:
        return whole
    fits = [(part.start, part.stop, part.fit) for part in parts.parts]
    return replace(whole, facts=facts | series_facts(whole, fits, differ=parts.differ))


def actigraph_details(
    result: ActigraphResult, coverage: Coverage, parts: Series | None
) -> dict[str, Any]:
    """What only a worn sensor has to say, for report.json; the shorter blocks also for the YAML."""
    details: dict[str, Any] = {
        "error_mg": _error_block(result),
        "coverage": coverage.as_dict(),
        "from_data": _data_share_block(result.final),
        "sphere": _sphere_block(result),
    }
    if parts is not None:
        details["series"] = series_block(parts)
    if result.loop is not None and result.loop.wander is not None:
        wander = result.loop.wander
        if result.loop.sums is not None:
            details[sums.KEY] = sums.sums_block(result.loop.sums)
        details[KEY] = recorded_block(
            result.final,
            result.loop.ambiguous,
            reading=MG * wander.scatter,
            settings={},
            drift=wander.sd,
        )
    return details


def _error_block(result: ActigraphResult) -> dict[str, Any]:
    """Mean error of |a| over posture runs, mg: raw, nine parameters, final; rms beside."""
    error = result.error
    return {
        "metric": "mean absolute error of the norm over posture runs",
        "raw": error.raw,
        "base_fitted": error.base,
        "final_fitted": error.final,
        "base_held_out": error.held_out.base,
        "final_held_out": error.held_out.final,
        "base_held_out_rms": result.base_held.rms() / MG,
        "final_held_out_rms": result.final_held.rms() / MG,
        "held_out_blocks": int(np.unique(result.final.observations.group).size),
    }


def _noise_block(fit: Fit) -> dict[str, float]:
    """What one posture scatters by when it comes again, mg, with its sd."""
    sigma = fit.noise.factor * float(np.median(fit.at.sigma)) / MG
    return {"reading_mg": sigma, "reading_sd_mg": sigma * float(fit.noise_sd[0])}


def _data_share_block(fit: Fit) -> dict[str, float]:
    """Of each parameter: 1 - (sd / typical size)², 0 where nothing was learnt, 1 where all was."""
    return {p.name: float(v) for p, v in zip(fit.parameters, from_data(fit), strict=True)}


def _sphere_block(result: ActigraphResult) -> list[dict[str, Any]]:
    """Error over the sphere, cell by cell."""
    cells = sphere_cells(result.base, result.final, result.final_held)
    return [
        {("name" if k == "name" else k if k == "runs" else f"{k}_mg"): v
         for k, v in asdict(c).items()}
        for c in cells
    ]  # fmt: skip
