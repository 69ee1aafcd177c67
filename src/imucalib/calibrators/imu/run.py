"""A finished calibration of one IMU: judged, in the words of all calibrators."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from imucalib.calibration.findings import Check, Findings, FoundStep, Gain, Untestable
from imucalib.calibration.outcome import ErrorSummary, HeldOutError, Limit, Outcome, Run
from imucalib.calibration.provenance import provenance_of
from imucalib.calibrators.imu.calibrate import ImuResult, calibrate_imu
from imucalib.calibrators.imu.calibration import imu_calibration, imu_details
from imucalib.calibrators.imu.plan import open_words
from imucalib.calibrators.imu.request import ImuRequest, gyro_effects
from imucalib.calibrators.lab.errors import rms
from imucalib.core.sphere import even_directions
from imucalib.estimators.turns import GAIN, TurnFit
from imucalib.loop.found import Score, Unexplained
from imucalib.loop.posterior.words import of_each
from imucalib.recording.mapping import FieldMapping
from imucalib.significant_digits import plus_minus
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
        held_out=HeldOutError(rms(held.raw), rms(held.base), rms(held.final)),
    )


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
    if not request.loop:
        return replace(rests, only=request.only, without=request.without)
    problem, gained = result.found.problem, result.held_out.gained
    steps, unnamed = _steps(result), _unnamed(result)
    names, refused = tuple(s.effect for s in steps), result.refused
    steps = () if refused else steps
    turns = "nothing missing"
    if unnamed:
        turns = "explained in part" if steps else "unexplained"
    if steps:
        turns = turns if gained.proved else "suspected"
        turns = "explained" if turns == "nothing missing" else turns
    verdict = max(rests.verdict, turns, key=_VERDICTS.index)
    if {rests.verdict, turns} == {"explained", "unexplained"}:
        verdict = "explained in part"
    gain, noise = rests.gain, result.fit.noise
    if steps:
        sizes = (gained.before, gained.after, gained.low, gained.high)
        gain = Gain(*sizes, gained.proved, "deg")
    words = (
        f"off by {noise.floor / DEG:.2g} deg and {100.0 * noise.per_angle:.2g} % of the angle "
        f"each; bias walk {float(np.mean(noise.walk)) / DEG:.2g} deg/s per root s"
    )
    absorbed = (n for n in problem.absorbed if n not in rests.missing)
    declared = (n for n in request.declare if n in gyro_effects(request.extra_effects))
    return replace(
        rests,
        verdict=verdict,
        steps=(*steps, *rests.steps),
        rejected=(
            *rests.rejected,
            *((n, "turns that took no part refuse it") for n in names if refused),
        ),
        refuted=(*rests.refuted, *(names if refused else ())),
        unexplained=(*unnamed, *rests.unexplained),
        scores=tuple(sorted((*_scores(result), *rests.scores), key=lambda s: -s.probability)),
        missing={**rests.missing, **result.found.lacking.missing},
        not_testable=(
            *rests.not_testable,
            *(Untestable(n, "a typical size", 0.0, "deg") for n in absorbed),
        ),
        declared=(*rests.declared, *((n, "") for n in declared)),
        gain=gain,
        facts=(*rests.facts, ("turns", words)),
    )


def _steps(result: ImuResult) -> tuple[FoundStep, ...]:
    """What the turns show and that has a name."""
    components, gained = result.found.problem.components, result.held_out.gained
    check = Check("held-out error, rms", "deg", gained.before, gained.after, 3)
    sizes, steps = _sizes(result), []
    for place in result.found.said.places:
        component = components[place.component]
        if not component.named:
            continue
        rivals = tuple((components[c].name, share) for c, share in place.rivals)
        steps.append(
            FoundStep(
                effect=component.name,
                evidence=place.log_odds,
                checks=(check,),
                aliases=tuple(n for n, _ in rivals if n != component.name),
                size=sizes.get(component.name, ""),
                certain=place.certain and gained.proved,
                probability=place.probability,
                rivals=rivals,
            )
        )
    return tuple(steps)


def _sizes(result: ImuResult) -> dict[str, str]:
    """Found effects' numbers in words, by name."""
    final = result.found.final
    sd = np.sqrt(np.diag(final.gains))[GAIN:]
    numbers = zip(final.state.theta.tolist(), sd.tolist(), strict=True)
    found = {}
    for term in result.found.terms:
        each = [term.effect.each[int(k)] for k in term.own]
        words = (
            f"{p.name.rpartition('_')[2]} {plus_minus(*number, p.unit)}"
            for p, number in zip(each, numbers, strict=False)
        )
        found[term.name] = ", ".join(words)
    return found


def _unnamed(result: ImuResult) -> tuple[Unexplained, ...]:
    """What the turns show and that has no name, or is refused."""
    components = result.found.problem.components
    return tuple(
        Unexplained(
            name=components[place.component].name,
            driver=components[place.component].driver,
            kind="probe",
            probability=place.probability,
            evidence=0.0,
            rivals=tuple(components[c].name for c, _ in place.rivals),
        )
        for place in result.found.said.places
        if result.refused or not components[place.component].named
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
