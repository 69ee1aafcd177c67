"""A finished calibration of one IMU: judged, in the words of all calibrators."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.findings import Check, Findings, FoundStep, Gain, Untestable
from imucalib.calibration.outcome import ErrorSummary, HeldOutError, Limit, Outcome, Run
from imucalib.calibration.provenance import provenance_of
from imucalib.calibrators.imu.calibrate import ImuRequest, ImuResult, calibrate_imu
from imucalib.calibrators.imu.calibration import imu_calibration, imu_details
from imucalib.calibrators.imu.plan import open_words
from imucalib.core.sphere import even_directions
from imucalib.estimators.turns import GAIN, TurnFit
from imucalib.loop.found import Score, Unexplained
from imucalib.loop.held_out import Difference
from imucalib.loop.posterior.words import Place, of_each
from imucalib.recording.mapping import FieldMapping
from imucalib.units import DEG

_NORMAL_95 = 1.96
#: From weakest to strongest, what two searches say together.
_VERDICTS = (
    "not run",
    "nothing missing",
    "explained",
    "explained in part",
    "suspected",
    "unexplained",
)
_PLAN = (
    "turn by 135 deg about x, y and z in turn, every second round backwards, with 2 s of rest on "
    "something hard between"
)


@dataclass(frozen=True, kw_only=True)
class ImuRun(Run):
    """A finished run, with every stage for its own report."""

    result: ImuResult
    request: ImuRequest


def run_imu(
    paths: Sequence[Path], mapping: FieldMapping, request: ImuRequest, say: Callable[[str], None]
) -> ImuRun:
    """From logs to a run. Errors as in `calibrate_imu`."""
    result = calibrate_imu(paths, mapping, request, say)
    rests = result.accelerometer.outcome
    open_gains = open_words(result.fit.gains[:GAIN, :GAIN])
    error = _error(result)
    outcome = Outcome(
        calibrator="imu",
        errors=(error, *rests.errors),
        provenance=provenance_of(
            path=rests.provenance.path,
            sha256=rests.provenance.sha256,
            parts=rests.provenance.parts,
            samples=sum(max(len(c.t) for c in r.channels.values()) for r in result.recordings),
            gaps=rests.provenance.gaps,
            mapping=rests.provenance.mapping,
            settings=request.stated(),
            seed=request.seed,
            command=request.command,
        ),
        findings=_findings(result, request),
        quality=rests.quality
        and replace(rests.quality, converged=rests.quality.converged and result.fit.converged),
        reasons=(*rests.reasons, *(f"the turns leave open {words}" for words in open_gains)),
        advice=(*_advice(result, open_gains), *rests.advice),
        undecided=rests.undecided,
        limits=_limits(request, error, rests.errors[0]),
        notes=(*rests.notes, *_notes(result)),
        weak=bool(open_gains),
        left=rests.left,
    )
    details = imu_details(result)
    return ImuRun(
        outcome=outcome,
        calibration=imu_calibration(result, outcome, details),
        details=details,
        result=result,
        request=request,
    )


def _error(result: ImuResult) -> ErrorSummary:
    held, (raw, base, final) = result.held_out, result.fitted
    noisy = result.imu.turns.white * np.sqrt(np.mean(result.imu.turns.spans[1]))
    return ErrorSummary(
        metric="gravity carried over a turn, rms",
        unit="deg",
        raw=raw,
        base=base,
        final=final,
        floor=float(np.hypot(noisy, np.sqrt(2.0) * np.mean(result.imu.turns.force_sd)) / DEG),
        held_out=HeldOutError(_rms(held.raw), _rms(held.base), _rms(held.final)),
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def heading_drift(fit: TurnFit) -> float:
    """deg, 95 %, by which an angle is off after a turn of 360 deg about the axis that the gains
    know least, of the calibration and of errors that grow with the angle."""
    axes = even_directions(300)
    outer = np.einsum("ni,nj->nij", axes, axes).reshape(-1, GAIN)
    own = fit.gains[:GAIN, :GAIN]
    worst = float(np.einsum("ni,ij,nj->n", outer, own, outer).max())
    return float(_NORMAL_95 * 360.0 * np.sqrt(worst + fit.noise.per_angle**2))


def _findings(result: ImuResult, request: ImuRequest) -> Findings:
    """What rests and turns say together."""
    rests = result.accelerometer.outcome.findings or Findings("not run")
    found = result.found
    if not request.loop:
        return replace(rests, only=request.only, without=request.without)
    steps = () if result.refused else tuple(_steps(result))
    left = _left(result)
    turns = "nothing missing"
    if left:
        turns = "explained in part" if steps else "unexplained"
    if steps:
        turns = "suspected" if not result.held_out.gained.proved else turns
        turns = "explained" if turns == "nothing missing" else turns
    verdict = max(rests.verdict, turns, key=_VERDICTS.index)
    if {rests.verdict, turns} == {"explained", "unexplained"}:
        verdict = "explained in part"
    names = tuple(s.effect for s in _steps(result))
    return replace(
        rests,
        verdict=verdict,
        steps=(*steps, *rests.steps),
        rejected=(
            *rests.rejected,
            *((n, "turns that took no part refuse it") for n in names if result.refused),
        ),
        refuted=(*rests.refuted, *(names if result.refused else ())),
        unexplained=(*left, *rests.unexplained),
        scores=tuple(sorted((*_scores(result), *rests.scores), key=lambda s: -s.probability)),
        missing={**rests.missing, **found.problem.missing},
        not_testable=(
            *rests.not_testable,
            *(
                Untestable(n, "a typical size", 0.0, "deg")
                for n in found.problem.absorbed
                if n not in rests.missing
            ),
        ),
        declared=(*rests.declared, *((n, "") for n in request.of_turns.declare)),
        gain=_gain(result.held_out.gained) if steps else rests.gain,
        facts=(*rests.facts, ("turns", _noise_words(result.fit))),
    )


def _steps(result: ImuResult) -> list[FoundStep]:
    """What is told of the turns and named."""
    problem, held, steps = result.found.problem, result.held_out.gained, []
    parameters = imu_parameters(result)
    for place in result.found.said.places:
        component = problem.components[place.component]
        if not component.named:
            continue
        own = parameters.get(component.name, ())
        rivals = tuple((problem.components[c].name, share) for c, share in place.rivals)
        steps.append(
            FoundStep(
                effect=component.name,
                evidence=place.log_odds,
                checks=(Check("held-out error, rms", "deg", held.before, held.after, 3),),
                aliases=tuple(n for n, _ in rivals if n != component.name),
                size=", ".join(own),
                certain=place.certain and held.proved,
                probability=place.probability,
                rivals=rivals,
            )
        )
    return steps


def imu_parameters(result: ImuResult) -> dict[str, tuple[str, ...]]:
    """Found effects' numbers in words, by name."""
    from imucalib.significant_digits import plus_minus

    sd = np.sqrt(np.diag(result.found.final.gains))[GAIN:]
    out, k = {}, 0
    for term in result.found.terms:
        words = []
        for i in term.own:
            p = term.effect.each[int(i)]
            value = float(result.found.final.state.theta[k])
            axis = p.name.rpartition("_")[2]
            words.append(f"{axis} {plus_minus(value, float(sd[k]), p.unit)}")
            k += 1
        out[term.name] = tuple(words)
    return out


def _left(result: ImuResult) -> tuple[Unexplained, ...]:
    """What is told and has no name, or is refused."""
    problem, left = result.found.problem, []
    for place in result.found.said.places:
        component = problem.components[place.component]
        if not component.named or result.refused:
            left.append(_without_a_name(result, place))
    return tuple(left)


def _without_a_name(result: ImuResult, place: Place) -> Unexplained:
    components = result.found.problem.components
    own = components[place.component]
    return Unexplained(
        name=own.name,
        driver=own.driver,
        kind="probe",
        probability=place.probability,
        evidence=0.0,
        rivals=tuple(components[c].name for c, _ in place.rivals),
    )


def _scores(result: ImuResult) -> list[Score]:
    found = result.found
    evidence, inside = of_each(found.posterior, len(found.problem.components))
    return [
        Score(
            name=c.name,
            kind="effect" if c.named else "probe",
            driver=c.driver,
            evidence=float(evidence[k]),
            probability=float(inside[k]),
            left=found.problem.seen[k][0],
            strength=found.problem.seen[k][1],
        )
        for k, c in enumerate(found.problem.components)
    ]


def _gain(found: Difference) -> Gain:
    return Gain(found.before, found.after, found.low, found.high, found.proved, "deg")


def _noise_words(fit: TurnFit) -> str:
    return (
        f"off by {fit.noise.floor / DEG:.2g} deg and {100.0 * fit.noise.per_angle:.2g} % of the "
        f"angle each; bias walk {float(np.mean(fit.noise.walk)) / DEG:.2g} deg/s per root s"
    )


def _limits(request: ImuRequest, error: ErrorSummary, rests: ErrorSummary) -> tuple[Limit, ...]:
    values = {"max-error": error, "max-force-error": rests}
    return tuple(
        Limit(name, values[name].held_out.final, limit, values[name].unit)
        for name, limit in request.limits.items()
    )


def _advice(result: ImuResult, open_gains: tuple[str, ...]) -> tuple[str, ...]:
    """What next: what the turns leave open, or how the gains become better."""
    if open_gains:
        return (f"Turn about other axes: {_PLAN}.",)
    left = result.imu.left_out
    words = (f"Record again what was left out: {left[0]}.",) if left else ()
    few = len(result.imu.turns.turns) < 12
    return (*words, *((f"Take more turns, a dozen or two: {_PLAN}.",) if few else ()))


def _notes(result: ImuResult) -> tuple[str, ...]:
    unseen = (
        "gravity does not show a turn about the vertical, nor a filter of the gyroscope: a motion "
        "from rest to rest turns the same angle"
    )
    left = result.imu.left_out
    count = (f"{len(left)} turns were left out", *left) if left else ()
    return (unseen, *count)
