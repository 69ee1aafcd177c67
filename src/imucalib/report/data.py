"""report.json: the machine's report, the same keys for every calibrator."""

from __future__ import annotations

from typing import Any

from imucalib.arrays import Array
from imucalib.calibration.calibration import StoredParameter
from imucalib.calibration.findings import Findings, FoundStep
from imucalib.calibration.outcome import Run
from imucalib.calibration.plain import plain
from imucalib.loop.found import Score
from imucalib.report.card import card_dict
from imucalib.report.document import Document, Plot, Series
from imucalib.significant_digits import per_cent

SCHEMA = "imucal/report/2"


def report_dict(run: Run) -> dict[str, Any]:
    """The report as plain types.

    Numbers that do not exist (no held-out part) are null, never NaN, which is no JSON.
    """
    outcome, calibration = run.outcome, run.calibration
    triads = [triad.as_dict() for triad in calibration.triads]
    content: dict[str, Any] = plain({
        "schema": SCHEMA,
        "calibrator": outcome.calibrator,
        "status": outcome.status,
        "exit_code": outcome.exit_code,
        "reasons": list(outcome.reasons),
        "parameters": [_parameter(p) for p in calibration.parameters],
        "covariance": _covariance(run),
        "loop": {
            "errors": [error.as_dict() for error in outcome.errors],
            "advice": list(outcome.advice),
            **_found(outcome.findings or Findings("not run")),
        },
        "limits": [
            {"name": x.name, "value": x.value, "limit": x.limit, "unit": x.unit, "broken": x.broken}
            for x in outcome.limits
        ],
        "undecided": list(outcome.undecided),
        "left": [
            {"name": x.name, "value": x.value, "accepted": x.accepted, "unit": x.unit,
             "beyond": x.beyond}
            for x in outcome.left
        ],
        "notes": list(outcome.notes),
        "provenance": outcome.provenance.as_dict(),
        **({"triads": triads} if triads else {"matrices": calibration.matrices().as_dict()}),
        **run.details,
    })  # fmt: skip
    return content


def shown_dict(document: Document) -> dict[str, Any]:
    """What only the document holds: its card, and its figures as series, five digits each."""
    plots = [(s.title, b) for s in document.sections for b in s.blocks if isinstance(b, Plot)]
    content: dict[str, Any] = plain({
        "card": card_dict(document.card) if document.card else None,
        "figures": [
            {"section": section, "title": plot.title, "x": plot.x_label, "y": plot.y_label,
             "caption": plot.caption, "series": [_series(s) for s in plot.series]}
            for section, plot in plots
        ],
    })  # fmt: skip
    return content


def _series(series: Series) -> dict[str, Any]:
    """Values (n,), the edges of bands and bars, and the names of points, where they exist."""
    edges = {"low": series.low, "high": series.high}
    return {
        "label": series.label,
        "x": _rounded(series.x),
        "y": _rounded(series.y),
        **{name: _rounded(edge) for name, edge in edges.items() if edge is not None},
        **({"names": list(series.names)} if series.names else {}),
    }


def _rounded(values: Array) -> list[float]:
    return [float(f"{v:.5g}") for v in values]


def _parameter(p: StoredParameter) -> dict[str, Any]:
    return {"name": p.name, "effect": p.effect, "value": p.value, "sd": p.sd, "unit": p.unit}


def _covariance(run: Run) -> dict[str, Any]:
    covariance, quality = run.calibration.covariance, run.outcome.quality
    if quality is None:
        return {"estimated_noise": covariance}
    return {
        "estimated_noise": covariance,
        "declared_noise": covariance / quality.noise_factor**2,
        "chi2": quality.chi2,
        "dof": quality.dof,
        "noise_factor": quality.noise_factor,
        "condition": quality.condition,
    }


def _found(found: Findings) -> dict[str, Any]:
    return {
        "verdict": found.verdict,
        "gain": None if found.gain is None else vars(found.gain),
        "declared": [{"effect": name, "size": size} for name, size in found.declared],
        "only": list(found.only),
        "without": list(found.without),
        "record_errors": [
            {"where": r.where, "channel": r.channel, "size": r.size, "sd": r.sd, "unit": r.unit,
             "likely": r.likely, "probability": r.probability}
            for r in found.records
        ],
        "steps": [_step(step) for step in found.steps],
        "unexplained": [
            {"name": u.name, "driver": u.driver, "kind": u.kind, "probability": u.probability,
             "evidence_nats": u.evidence}
            for u in found.unexplained
        ],
        "rejected": [{"effect": name, "reason": why} for name, why in _reasons(found).items()],
        "refuted": list(found.refuted),
        "not_testable": [vars(u) for u in found.not_testable],
        "candidates": [
            {"name": s.name, "kind": s.kind, "evidence_nats": s.evidence,
             "probability": s.probability, "left": s.left,
             "lambda_at_typical_size": s.strength, "size_m_per_s2": s.size}
            for s in found.scores
        ],
    }  # fmt: skip


def _step(step: FoundStep) -> dict[str, Any]:
    return {
        "effect": step.effect,
        "size": step.size,
        "probability": step.probability,
        "in_its_place": [{"effect": name, "share": share} for name, share in step.rivals],
        "evidence_nats": step.evidence,
        "held_out_nats": list(step.held_out),
        "checks": [
            {"metric": c.metric, "unit": c.unit, "before": c.before, "after": c.after}
            for c in step.checks
        ],
        "aliases": list(step.aliases),
        "certain": step.certain,
        "formula": step.formula,
        "parameters": [_parameter(p) for p in step.parameters],
    }


def _reasons(found: Findings) -> dict[str, str]:
    """Why each effect was not taken."""
    reasons = {s.name: _why(s, found) for s in found.scores if s.kind == "effect"}
    reasons |= dict(found.rejected)
    return reasons | {name: f"not tested: {why}" for name, why in found.missing.items()}


def _why(score: Score, found: Findings) -> str:
    if score.absorbed:
        return "absorbed by the fitted parameters: these data cannot show it"
    numbers = f"{per_cent(score.probability)} likely, {score.evidence:.2f} nats by itself"
    best = found.scores[0]
    if score.evidence > 0.0 and score.evidence < best.evidence:
        return f"{best.name} explains more: {numbers}"
    return f"no evidence: {numbers}"
