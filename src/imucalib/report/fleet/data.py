"""A fleet as plain types."""

from __future__ import annotations

from typing import Any

import numpy as np

from imucalib.calibration.plain import plain
from imucalib.cohort.fleet.outcome import Fleet, Recording


def fleet_dict(fleet: Fleet) -> dict[str, Any]:
    """report.json of a fleet."""
    gain, search = fleet.difference, fleet.search
    found, first = (search.found, search.first) if search else ((), ())
    content = {
        "calibrator": fleet.asked.calibrator,
        "verdict": fleet.verdict,
        "exit_code": fleet.exit_code,
        "found": [
            {
                "effect": one.effect, "p": one.pooled.p, "evidence_nats": one.pooled.evidence,
                "foretold_nats": one.nats, "rivals": list(one.rivals), "devices": list(one.able),
                "common_typical": one.sizes.common, "scatter_typical": one.sizes.scatter,
            }
            for one in found
        ],
        "held_out_mg": gain and {
            "before": gain.before, "after": gain.after, "gain": gain.gain, "low": gain.low,
            "high": gain.high, "nats": gain.nats, "nats_low": gain.nats_low,
        },
        "devices": [
            {"name": m.name, "recordings": [_recording(r) for r in m.recordings],
             "base_mg": _finite(m.base), "final_mg": _finite(m.final),
             "found_by_the_others": list(m.told)}
            for m in fleet.members
        ],
        **_members(fleet),
        "tried": [
            {"effect": one.effect, "evidence_nats": one.evidence, "p": one.p,
             "devices": one.devices}
            for one in first
        ],
        "refused": [
            {"effect": name, "why": why} for name, why in (search.refused if search else ())
        ],
        "failed": [{"name": name, "why": why} for name, why in fleet.failed],
        "notes": list(fleet.notes),
        "provenance": _provenance(fleet),
    }  # fmt: skip
    return dict(plain(content))


def _members(fleet: Fleet) -> dict[str, Any]:
    """What scatters between devices, and which of them stand apart."""
    return {
        "between_devices": [
            {"parameter": s.name, "unit": s.unit, "mean": s.mean, "mean_sd": s.mean_sd,
             "scatter": s.scatter, "scatter_95": [s.interval.low, s.interval.high],
             "between_recordings": s.sessions and vars(s.sessions)}
            for s in fleet.spreads
        ],
        "outliers": [
            {"device": o.device, "parameter": o.parameter, "value": o.value, "sd": o.sd,
             "unit": o.unit, "others": o.mean, "scatter": o.scatter, "p": o.p}
            for o in fleet.outliers
        ],
    }  # fmt: skip


def _provenance(fleet: Fleet) -> dict[str, Any]:
    """Enough to compute it again."""
    made = [r.provenance for m in fleet.members for r in m.recordings]
    return {
        "inputs": [{"input": one.path, "sha256": one.sha256} for one in made],
        "settings": dict(fleet.asked.settings),
        "command": fleet.asked.command,
        "seed": fleet.asked.seed,
        "versions": made[-1].versions,
        "time": made[-1].time,
    }


def _recording(one: Recording) -> dict[str, Any]:
    return {"name": one.name, "input": one.provenance.path, "kept": one.kept or None}


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
