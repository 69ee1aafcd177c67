"""report.json: the machine's report, the same keys for every calibrator."""

from __future__ import annotations

import math
from typing import Any

from imucalib.calibration.outcome import ErrorSummary, Outcome
from imucalib.loop.difference import Difference
from imucalib.loop.evidence import Score
from imucalib.loop.found import FitLoop

SCHEMA = "imucal/report/1"


def report_dict(outcome: Outcome, details: dict[str, Any]) -> dict[str, Any]:
    """The report as plain types; `details` is what only this calibrator has to say.

    Numbers that do not exist (no held-out part) are null, never NaN, which is no JSON.
    """
    fit = outcome.fit
    slices = fit.model.slices(fit.observations.context)
    effect_of = {k: n for n, part in slices.items() for k in range(part.start, part.stop)}
    content: dict[str, Any] = _plain({
        "schema": SCHEMA,
        "calibrator": outcome.calibrator,
        "status": outcome.status,
        "exit_code": outcome.exit_code,
        "reasons": list(outcome.reasons),
        "parameters": [
            {"name": p.name, "effect": effect_of[k], "value": float(fit.theta[k]),
             "sd": float(fit.sd[k]), "unit": p.unit}
            for k, p in enumerate(fit.parameters)
        ],
        "covariance": {
            "estimated_noise": fit.covariance.tolist(),
            "declared_noise": fit.declared_covariance.tolist(),
            "chi2": fit.chi2,
            "dof": fit.dof,
            "noise_factor": fit.noise.factor,
            "condition": fit.condition,
        },
        "loop": _loop(outcome),
        "limits": [
            {"name": x.name, "value": x.value, "limit": x.limit, "unit": x.unit, "broken": x.broken}
            for x in outcome.limits
        ],
        "notes": list(outcome.notes),
        "provenance": {
            "input": outcome.provenance.path,
            "sha256": outcome.provenance.sha256,
            "samples": outcome.provenance.samples,
            "gaps": outcome.provenance.gaps,
            "mapping": dict(outcome.provenance.mapping),
            "settings": dict(outcome.provenance.settings),
            "seed": outcome.provenance.seed,
            "versions": dict(outcome.provenance.versions),
            "time": outcome.provenance.time,
        },
        **details,
    })  # fmt: skip
    return content


def _error(error: ErrorSummary) -> dict[str, Any]:
    held = error.held_out
    return {
        "metric": error.metric,
        "unit": error.unit,
        "raw": error.raw,
        "base": error.base,
        "final": error.final,
        "floor": error.floor,
        "held_out": {"raw": held.raw, "base": held.base, "final": held.final},
    }


def _loop(outcome: Outcome) -> dict[str, Any]:
    loop = outcome.loop
    shared = {"error": _error(outcome.error), "advice": list(outcome.advice)}
    if loop is None:
        return {**shared, "verdict": "not run", "record_errors": [], "steps": [], "rejected": [],
                "unexplained": [], "candidates": []}  # fmt: skip
    return {**shared, **_found(loop), **_candidates(loop)}


def _found(loop: FitLoop) -> dict[str, Any]:
    final = loop.final
    slices = final.model.slices(final.observations.context)
    return {
        "verdict": loop.verdict,
        "difference": _difference(loop.difference, "mg"),
        "density": _difference(loop.density, "nats an observation"),
        "wander": loop.wander and {
            "size_mg": loop.wander.size, "hours": loop.wander.hours,
            "scatter_mg": loop.wander.scatter, "evidence_nats": loop.wander.evidence,
        },
        "record_errors": [
            {"where": r.where, "channel": r.channel, "size": r.size, "sd": r.sd, "unit": r.unit,
             "likely": r.likely, "p_value": r.p}
            for r in loop.records
        ],
        "steps": [
            {"effect": s.effect, "p_value": s.p, "draws": s.draws, "evidence_nats": s.evidence,
             "checked_before": s.checked[0].before, "checked_after": s.checked[0].after,
             "held_out_unit": s.checked[0].unit, "aliases": list(s.aliases),
             "gains_nats": list(s.gains),
             "parameters": [
                 {"name": final.parameters[k].name, "value": float(final.theta[k]),
                  "sd": float(final.sd[k]), "unit": final.parameters[k].unit}
                 for k in range(slices[s.effect].start, slices[s.effect].stop)
             ]}
            for s in loop.steps
        ],
        "unexplained": [
            {"name": u.name, "driver": u.driver, "kind": u.kind, "p_value": u.p,
             "share": u.share, "evidence_nats": u.evidence}
            for u in loop.unexplained
        ],
    }  # fmt: skip


def _difference(found: Difference | None, unit: str) -> dict[str, Any] | None:
    if found is None:
        return None
    return {"before": found.before, "after": found.after, "gain": found.gain, "low": found.low,
            "high": found.high, "plain_low": found.plain_low, "parts": found.parts,
            "unit": unit}  # fmt: skip


def _candidates(loop: FitLoop) -> dict[str, Any]:
    reasons = {s.name: _why(s, loop) for s in loop.scores if s.candidate.kind == "effect"}
    reasons |= dict(loop.rejected)
    reasons |= {name: f"not tested: {why}" for name, why in loop.missing.items()}
    return {
        "rejected": [{"effect": name, "reason": reason} for name, reason in reasons.items()],
        "candidates": [
            {"name": s.name, "kind": s.candidate.kind, "evidence_nats": s.evidence, "p_value": s.p,
             "left": s.left, "lambda_at_typical_size": s.strength, "size_m_per_s2": s.size}
            for s in loop.scores
        ],
    }  # fmt: skip


def _why(found: Score, loop: FitLoop) -> str:
    if found.absorbed:
        return "absorbed by the fitted parameters: these data cannot show it"
    numbers = f"{found.evidence:.2f} nats, p {found.p:.2g} in the whole search"
    best = loop.scores[0]
    if loop.unexplained and found.evidence < best.evidence and found.p <= loop.unexplained[0].p:
        return f"{best.name} explains more: {numbers}"
    return f"no evidence: {numbers}"


def _plain(value: Any) -> Any:
    """Numpy scalars to Python, NaN and infinity to null."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, bool | int | str) or value is None:
        return value
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    number = float(value)
    return number if math.isfinite(number) else None
