"""The calibration that an actigraph run writes, and the blocks that people read beside it."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import numpy as np

from imucalib.calibration.calibration import Calibration, from_fit
from imucalib.calibration.series import series_facts
from imucalib.calibrators.actigraph.advice import weakest
from imucalib.calibrators.actigraph.errors import sphere_cells
from imucalib.calibrators.actigraph.observations import quantisation
from imucalib.calibrators.actigraph.run import ActigraphRun
from imucalib.calibrators.actigraph.weak import from_data
from imucalib.units import MG


def actigraph_calibration(run: ActigraphRun) -> Calibration:
    """The calibration of a run's final fit."""
    origin = run.outcome.provenance
    facts: dict[str, Any] = {
        "gravity_source": run.request.gravity_source,
        "frame": "x keeps its direction; gravity alone cannot see a rotation of the frame",
        "clock": {"start_ns": run.scanned.start_ns, "span_s": max(run.scanned.stop, 1.0)},
        "error_mg": error_block(run),
        "coverage": coverage_block(run),
        "from_data": data_share_block(run),
        "provenance": {
            "input": origin.path,
            "sha256": origin.sha256,
            "samples": origin.samples,
            "gaps": origin.gaps,
            "mapping": dict(origin.mapping),
            "settings": dict(origin.settings),
            "seed": origin.seed,
            "versions": dict(origin.versions),
            "time": origin.time,
        },
    }
    whole = from_fit(
        run.result.final,
        "actigraph",
        raw_unit="m/s2",
        raw_to_si=1.0,
        gravity=run.request.gravity,
        status=run.outcome.status,
        reasons=run.outcome.reasons,
        facts=facts,
    )
    if run.series is None:
        return whole
    parts = [(part.start, part.stop, part.fit) for part in run.series.parts]
    return replace(whole, facts=facts | series_facts(whole, parts, differ=run.series.differ))


def error_block(run: ActigraphRun) -> dict[str, Any]:
    """Mean error of |a| over posture runs, mg: raw, nine parameters, final; rms beside."""
    error, result = run.outcome.error, run.result
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


def coverage_block(run: ActigraphRun) -> dict[str, Any]:
    """What was recorded: time, windows, range of each axis, temperature."""
    runs, scanned = run.runs, run.scanned
    mean_sd, worst_sd = weakest(run.result)
    reading = runs.mean / run.request.gravity
    warm = runs.temperature[np.isfinite(runs.temperature)]
    block: dict[str, Any] = {
        "hours": scanned.stop / 3600.0,
        "rate_hz": scanned.rate,
        "windows": runs.total,
        "still_windows": runs.still,
        "still_hours": runs.still * run.request.window / 3600.0,
        "posture_runs": runs.n,
        "runs_that_count_less": run.result.light,
        "noise_of_a_sample_mg": (runs.noise / MG).tolist(),
        "resolution_mg": (runs.resolution / MG).tolist(),
        "quantisation_mg": quantisation(runs) / MG,
        "axis_range_g": {
            a: [float(reading[:, k].min()), float(reading[:, k].max())] for k, a in enumerate("xyz")
        },
        "norm_sd_mean_mg": mean_sd,
        "norm_sd_largest_mg": worst_sd,
    }
    if warm.size:
        block["temperature_degC"] = [float(warm.min()), float(warm.max())]
        block["temperature_reference_degC"] = 25.0
    return block


def data_share_block(run: ActigraphRun) -> dict[str, float]:
    """Of each parameter: 1 - (sd / typical size)², 0 where nothing was learnt, 1 where all was."""
    fit = run.result.final
    return {p.name: float(v) for p, v in zip(fit.parameters, from_data(fit), strict=True)}


def sphere_block(run: ActigraphRun) -> list[dict[str, Any]]:
    """Error over the sphere, cell by cell."""
    result = run.result
    cells = sphere_cells(result.base, result.final, result.final_held)
    return [
        {("name" if k == "name" else k if k == "runs" else f"{k}_mg"): v
         for k, v in asdict(c).items()}
        for c in cells
    ]  # fmt: skip
