"""A fleet as plain types."""

from __future__ import annotations

from typing import Any

import numpy as np

from imucalib.calibration.plain import plain
from imucalib.cohort.fleet.run import Fleet


def fleet_dict(fleet: Fleet) -> dict[str, Any]:
    """report.json of a fleet."""
    gain = fleet.difference
    content = {
        "verdict": fleet.verdict,
        "exit_code": fleet.exit_code,
        "found": [
            {
                "effect": one.effect, "p": one.pooled.p, "evidence_nats": one.pooled.evidence,
                "foretold_nats": one.nats, "rivals": list(one.rivals), "devices": list(one.able),
                "common_typical": one.sizes.common, "scatter_typical": one.sizes.scatter,
            }
            for one in fleet.search.found
        ],
        "held_out_mg": gain and {
            "before": gain.before, "after": gain.after, "gain": gain.gain, "low": gain.low,
            "high": gain.high,
        },
        "devices": [
            {"name": m.name, "input": m.run.outcome.provenance.path, "base_mg": _finite(m.base),
             "final_mg": _finite(m.final), "found_by_the_others": list(m.told)}
            for m in fleet.members
        ],
        "between_devices": [
            {"parameter": s.name, "unit": s.unit, "mean": s.mean, "mean_sd": s.mean_sd,
             "scatter": s.scatter}
            for s in fleet.spreads
        ],
        "outliers": [
            {"device": o.device, "parameter": o.parameter, "value": o.value, "sd": o.sd,
             "unit": o.unit, "others": o.mean, "scatter": o.scatter, "p": o.p}
            for o in fleet.outliers
        ],
        "tried": [
            {"effect": one.effect, "evidence_nats": one.evidence, "p": one.p,
             "devices": one.devices}
            for one in fleet.search.first
        ],
        "refused": [{"effect": name, "why": why} for name, why in fleet.search.refused],
        "failed": [{"name": name, "why": why} for name, why in fleet.failed],
        "provenance": _provenance(fleet),
    }  # fmt: skip
    return dict(plain(content))


def _provenance(fleet: Fleet) -> dict[str, Any]:
    """Enough to compute it again."""
    made = [m.run.outcome.provenance for m in fleet.members]
    return {
        "inputs": [{"input": one.path, "sha256": one.sha256} for one in made],
        "settings": fleet.request.stated(),
        "command": fleet.request.command,
        "seed": fleet.request.seed,
        "versions": made[-1].versions,
        "time": made[-1].time,
    }


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
