"""A finished run for programs: report.json, with the same keys for every calibrator.

Numbers that do not exist (no held-out part) are null, never NaN, which is no JSON.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from imucalib.arrays import Array
from imucalib.calibration.findings import Findings, Gain, Untestable
from imucalib.calibration.outcome import ErrorSummary, Left, Limit, Provenance, Run, Status
from imucalib.core.fit import StoredParameter
from imucalib.data import Data, plain
from imucalib.posterior.closed_loop.found import Score, Step, Unexplained
from imucalib.recording.identity import Identity
from imucalib.significant_digits import per_cent


class Covariance(Data):
    """Of the parameters, and what the fit says of the noise."""

    estimated_noise: Array
    chi2: float | None = None
    dof: int | None = None
    noise_factor: float | None = None
    condition: float | None = None


class EffectSize(Data):
    """An effect of the base model."""

    effect: str
    size: str


class WrongRecord(Data):
    """A record that does not belong to the rest."""

    where: str
    channel: str
    size: Annotated[float, "By which it is off."]
    sd: float
    unit: str
    likely: str
    probability: float


class Rejected(Data):
    """An effect that was not added."""

    effect: str
    reason: str


class LoopFacts(Data):
    """What was searched for and found."""

    errors: Annotated[tuple[ErrorSummary, ...], "The principal metric first."]
    advice: tuple[str, ...]
    verdict: str
    p_nothing_missing: Annotated[float, "Null where no search was run."]
    gain: Gain | None
    declared: tuple[EffectSize, ...]
    only: tuple[str, ...]
    without: tuple[str, ...]
    record_errors: tuple[WrongRecord, ...]
    steps: tuple[Step, ...]
    unexplained: tuple[Unexplained, ...]
    rejected: tuple[Rejected, ...]
    refuted: Annotated[tuple[str, ...], "Taken and put back, since data that took no part refuse."]
    not_testable: tuple[Untestable, ...]
    candidates: tuple[Score, ...]


class Worth(Data):
    """What the sensor is good to in a quantity."""

    quantity: str
    value: str
    detail: str


class CardFacts(Data):
    """What a reader takes away."""

    good_to: tuple[Worth, ...]
    found: tuple[str, ...]
    to_do: tuple[str, ...]
    command: str


class SeriesFacts(Data):
    """A data series."""

    label: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    low: Annotated[tuple[float, ...] | None, "Edge of a band or of bars."] = None
    high: tuple[float, ...] | None = None
    names: tuple[str, ...] | None = None


class Figure(Data):
    """A figure of report.html, five digits each."""

    section: str
    title: str
    x: str
    y: str
    caption: str
    series: tuple[SeriesFacts, ...]


class Shown(Data):
    """What only the page holds."""

    card: CardFacts | None
    figures: tuple[Figure, ...]


class Result(Data, name="report/2"):
    """report.json of every calibrator; each adds blocks of its own."""

    calibrator: str
    status: Status
    exit_code: int
    reasons: tuple[str, ...]
    sensor: Identity
    parameters: tuple[StoredParameter, ...]
    covariance: Covariance
    loop: LoopFacts
    limits: tuple[Limit, ...]
    undecided: tuple[str, ...]
    left: tuple[Left, ...]
    notes: tuple[str, ...]
    provenance: Provenance
    triads: Annotated[tuple[Mapping[str, Any], ...] | None, "Of an array."] = None
    matrices: Annotated[Mapping[str, Any] | None, "Of one sensor: its linear part."] = None
    card: CardFacts | None = None
    figures: tuple[Figure, ...] | None = None


def describe_run(run: Run) -> dict[str, Any]:
    """The report as plain types, with the blocks that only this calibrator has."""
    outcome, calibration = run.outcome, run.calibration
    triads = tuple(triad.as_dict() for triad in calibration.triads) or None
    estimated, fit = Covariance(calibration.covariance), outcome.fit
    if fit is not None:
        renamed = "noise_factor=noise.factor"
        estimated = Covariance.of(fit, renamed, estimated_noise=calibration.covariance)
    made = Result(
        calibrator=outcome.calibrator,
        status=outcome.status,
        exit_code=outcome.exit_code,
        reasons=outcome.reasons,
        sensor=outcome.sensor,
        parameters=calibration.parameters,
        covariance=estimated,
        loop=_describe_loop(run),
        limits=outcome.limits,
        undecided=tuple(map(str, outcome.undecided)),
        left=outcome.left,
        notes=outcome.notes,
        provenance=outcome.provenance,
        triads=triads,
        matrices=None if triads else calibration.matrices().as_dict(),
    )
    whole: dict[str, Any] = made.as_dict() | plain(run.details)
    return whole


def _describe_loop(run: Run) -> LoopFacts:
    found = run.outcome.findings or Findings("not run")
    # Why each effect was not added.
    reasons = {s.name: _why(s, found) for s in found.scores if s.kind == "effect"}
    reasons |= dict(found.rejected)
    reasons |= {name: f"not tested: {why}" for name, why in found.missing.items()}
    return LoopFacts.of(
        found,
        "p_nothing_missing=complete candidates=scores",
        errors=run.outcome.errors,
        advice=tuple(map(str, run.outcome.advice)),
        declared=tuple(EffectSize(*one) for one in found.declared),
        record_errors=tuple(map(WrongRecord.of, found.records)),
        rejected=tuple(Rejected(*one) for one in reasons.items()),
    )


def _why(score: Score, found: Findings) -> str:
    if score.absorbed:
        return "absorbed by the fitted parameters: these data cannot show it"
    numbers = f"{per_cent(score.probability)} likely, {score.evidence_nats:.2f} nats by itself"
    best = found.scores[0]
    if score.evidence_nats > 0.0 and score.evidence_nats < best.evidence_nats:
        return f"{best.name} explains more: {numbers}"
    return f"no evidence: {numbers}"
