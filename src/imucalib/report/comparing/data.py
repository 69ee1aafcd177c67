"""A comparison as plain types."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import numpy as np

from imucalib.calibration.comparison.compare import ALPHA, Comparison, Drift
from imucalib.calibration.plain import plain

SCHEMA = "imucal/comparison/1"


def comparison_dict(found: Comparison) -> dict[str, Any]:
    """Ready for JSON; what does not exist is null."""
    fit, basis = found.agreement, found.basis
    content: dict[str, Any] = plain({
        "schema": SCHEMA,
        "calibrations": found.names,
        "verdict": found.verdict,
        "exit_code": found.exit_code,
        "basis": basis.words,
        "chi2": fit.chi2,
        "dof": fit.dof,
        "noise_dof": fit.noise_dof,
        "p": fit.p,
        "alpha": ALPHA,
        "z_rms": fit.z_rms,
        "differ_from_the_others": found.odd,
        "p_against_the_others": fit.without,
        "limits_stated": found.stated,
        "worst": [
            {"difference": m.worst.value, "sd": m.worst.sd, "unit": m.worst.unit,
             "limit": m.limit, "beyond": m.beyond, "sensor": m.sensor,
             "pair": [found.names[k] for k in m.worst.pair], "attitude": m.worst.attitude}
            for m in found.meanings
        ],
        "parameters": [
            {"name": name, "unit": unit, "value": basis.value[:, k],
             "sd": np.sqrt(basis.covariance[:, k, k]), "z": fit.z[:, k],
             "mean": fit.mean[k], "mean_sd": fit.mean_sd[k],
             **_between(found, k), **_slope(found, k)}
            for k, (name, unit) in enumerate(zip(basis.names, basis.units, strict=True))
        ],
        "drift": None if found.drift is None else _drift(found.drift),
        "notes": found.notes,
    })  # fmt: skip
    return content


def _between(found: Comparison, k: int) -> dict[str, Any]:
    if found.scatter is None:
        return {}
    own = found.scatter
    return {"between_sd": own.sd[k], "between_95": [own.low[k], own.high[k]], "z_rms": own.z_rms[k]}


def _slope(found: Comparison, k: int) -> dict[str, Any]:
    if found.drift is None:
        return {}
    own = found.drift.slopes[k]
    return {"per_day": own.value, "per_day_95": [own.value - own.half, own.value + own.half]}


def _drift(drift: Drift) -> dict[str, Any]:
    due, last = drift.due, float(drift.dates.days.max())

    def day(after: float) -> str | None:
        if not after < 36500.0:
            return None
        return (drift.dates.start + timedelta(days=last + after)).strftime("%Y-%m-%d")

    return {
        "dates_from": drift.dates.words,
        "days": drift.dates.days,
        "per_day": due.slope.value,
        "per_day_95": [due.slope.value - due.slope.half, due.slope.value + due.slope.half],
        "unit": due.unit,
        "attitude": due.attitude,
        "limit": due.limit,
        "reached": day(due.expected),
        "earliest": day(due.earliest),
    }
