"""A finished run for programs: report.json, with the same keys for every calibrator.

Numbers that do not exist (no held-out part) are null, never NaN, which is no JSON.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from imucalib.arrays import Array
from imucalib.calibration.findings import Findings, Gain, Untestable
from imucalib.calibration.outcome import ErrorSummary, Run, Status
from imucalib.calibration.provenance import Origin
from imucalib.core.fit import StoredParameter
from imucalib.data import Data, plain
from imucalib.posterior.closed_loop.found import Score, Step, Unexplained
from imucalib.recording.identity import Identity
from imucalib.significant_digits import per_cent


class OnboardFacts(Data):
    """In a flight controller, whose log has scale (raw - offset) of the sensor."""

    slot: Annotated[int | None, "Number in its parameters."] = None
    device: Annotated[int | None, "Its id."] = None
    offset: Annotated[tuple[float, ...] | None, "In SI units."] = None
    scale: tuple[float, ...] | None = None
    law: Annotated[str | None, "A stored one over temperature: taken off before, or ahead."] = None
    fault: Annotated[str | None, "Why no parameters are composed."] = None


class SensorFacts(Data):
    """Which sensor of which device it is, as the recording says; what it does not say is absent."""

    name: Annotated[str | None, "In the recording."] = None
    names: Annotated[tuple[str, ...] | None, "Topic or dataset, frame_id."] = None
    topic: str | None = None
    device: str | None = None
    serial: str | None = None
    unit: Annotated[str | None, "Of the readings in the file."] = None
    to_m_per_s2: tuple[float, ...] | None = None
    zero: Annotated[tuple[float, ...] | None, "Taken off readings in the unit before."] = None
    step: Annotated[tuple[float, ...] | None, "Smallest step between readings, m/s2."] = None
    rate_hz: float | None = None
    onboard: OnboardFacts | None = None
    onboard_rate: OnboardFacts | None = None


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


class LimitFacts(Data):
    """A limit that was set."""

    name: str
    value: float
    limit: float
    unit: str
    broken: bool


class LeftFacts(Data):
    """What is left unexplained."""

    name: str
    value: float
    accepted: float
    unit: str
    beyond: bool


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
    sensor: SensorFacts
    parameters: tuple[StoredParameter, ...]
    covariance: Covariance
    loop: LoopFacts
    limits: tuple[LimitFacts, ...]
    undecided: tuple[str, ...]
    left: tuple[LeftFacts, ...]
    notes: tuple[str, ...]
    provenance: Origin
    triads: Annotated[tuple[Mapping[str, Any], ...] | None, "Of an array."] = None
    matrices: Annotated[Mapping[str, Any] | None, "Of one sensor: its linear part."] = None
    card: CardFacts | None = None
    figures: tuple[Figure, ...] | None = None


def describe_run(run: Run) -> dict[str, Any]:
    """The report as plain types, with the blocks that only this calibrator has."""
    outcome, calibration = run.outcome, run.calibration
    triads = tuple(triad.as_dict() for triad in calibration.triads) or None
    made = Result(
        calibrator=outcome.calibrator,
        status=outcome.status,
        exit_code=outcome.exit_code,
        reasons=outcome.reasons,
        sensor=_describe_sensor(outcome.sensor),
        parameters=calibration.parameters,
        covariance=_covariance(run),
        loop=_describe_loop(run),
        limits=tuple(map(LimitFacts.of, outcome.limits)),
        undecided=tuple(map(str, outcome.undecided)),
        left=tuple(map(LeftFacts.of, outcome.left)),
        notes=outcome.notes,
        provenance=outcome.provenance.described,
        triads=triads,
        matrices=None if triads else calibration.matrices().as_dict(),
    )
    whole: dict[str, Any] = made.as_dict() | plain(run.details)
    return whole


def _describe_sensor(sensor: Identity) -> SensorFacts:
    known: dict[str, Any] = sensor.as_dict()
    boards = {k: OnboardFacts(**v) for k, v in known.items() if isinstance(v, dict)}
    return SensorFacts(**known | boards)


def _covariance(run: Run) -> Covariance:
    covariance, fit = run.calibration.covariance, run.outcome.fit
    if fit is None:
        return Covariance(covariance)
    return Covariance.of(fit, "noise_factor=noise.factor", estimated_noise=covariance)


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
