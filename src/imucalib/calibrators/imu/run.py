"""A finished calibration of one IMU: judged, in the words of all calibrators."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration, StoredParameter
from imucalib.calibration.findings import CheckedError, Findings, FoundStep, Gain, Untestable
from imucalib.calibration.gyroscope import BIAS, STAGE
from imucalib.calibration.gyroscope import GAIN as GAIN_EFFECT
from imucalib.calibration.outcome import ErrorSummary, HeldOutError, Limit, Outcome, Run
from imucalib.calibrators.imu.calibrate import ImuResult, calibrate_imu
from imucalib.calibrators.imu.plan import open_words
from imucalib.calibrators.imu.power_ups import bias_parts, differing, products_of
from imucalib.calibrators.imu.request import ImuRequest, gyro_effects
from imucalib.calibrators.lab.errors import rms
from imucalib.calibrators.lab.run import LabDetails
from imucalib.calibrators.sessions import Sessions, estimate_scatter
from imucalib.core.sphere import even_directions
from imucalib.data import Data
from imucalib.effects.forms import in_words
from imucalib.estimators.lateness import lateness
from imucalib.estimators.turns import ACCELEROMETER, GAIN, LOWER, TurnFit
from imucalib.inspection.noise import SensorNoise, noise_blocks
from imucalib.posterior.closed_loop.found import Score, Unexplained
from imucalib.posterior.closed_loop.words import of_each
from imucalib.recording.mapping import FieldMapping
from imucalib.significant_digits import plus_minus
from imucalib.units import DEG, MG

_NORMAL_95 = 1.96
#: Why what was found in the turns is not corrected.
_NEEDLESS = "not corrected: turns held out are no better with it"
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


class GyroscopeNoise(Data):
    """The gyroscope at rest, by axis; what the rests do not show is told as what it is at most."""

    rest_s: Annotated[float, "The longest."]
    white_deg_per_s_per_root_hz: tuple[float, ...]
    white_sd: Annotated[tuple[float | None, ...], "Null of an upper limit."]
    bias_instability_deg_per_s: tuple[float, ...]
    upper_limit: Annotated[bool, "Whether an instability is one."]


class ValueSd(Data):
    """A value and its standard deviation."""

    value: float
    sd: float


class ImuFacts(Data):
    """The gyroscope beside the accelerometer."""

    frame: str
    sample_interval_s: float | None
    turns: int
    turns_left_out: tuple[str, ...]
    rests: int
    gyroscope_noise: GyroscopeNoise
    bias_walk_deg_per_s_per_root_s: Array
    gyroscope_late_s: Annotated[ValueSd, "Behind the accelerometer."]
    turn_floor_deg: Annotated[float, "Noise of a turn, however short."]
    turn_error_per_angle: float


class TurnErrors(Data):
    """By what gravity is off after each turn that took no part."""

    raw: Array
    base: Array
    final: Array


class ImuDetails(LabDetails, kw_only=True, beside=("report", "calibrator", "imu")):
    """What only an IMU has to say, beside the bench of its rests."""

    imu: ImuFacts
    noise_density: Annotated[Mapping[str, Any], "As Kalibr has it."]
    held_out_turns_deg: TurnErrors


@dataclass(frozen=True, kw_only=True)
class ImuRun(Run):
    """A finished run, with every stage for its own report."""

    details: ImuDetails
    result: ImuResult
    request: ImuRequest
    sessions: Sessions | None = None


def run_imu(
    paths: Sequence[Path], mapping: FieldMapping, request: ImuRequest, say: Callable[[str], None]
) -> ImuRun:
    """From logs to a run. Errors as in `calibrate_imu`."""
    result = calibrate_imu(paths, mapping, request, say)
    rests = result.accelerometer.outcome
    open_gains = open_words(result.fit.gains[:GAIN, :GAIN])
    error, names = _error(result), result.accelerometer.table.sessions
    products = products_of(result.fit) if names else None
    samples = sum(max(len(c.t) for c in r.channels.values()) for r in result.recordings)
    both = rests.fit is not None and rests.fit.converged and result.fit.converged
    outcome = replace(
        rests,
        calibrator="imu",
        errors=(error, *rests.errors),
        provenance=replace(rests.provenance, samples=samples, settings=request.stated()),
        findings=_findings(result, request),
        fit=rests.fit and replace(rests.fit, converged=both),
        reasons=(
            *rests.reasons,
            *(f"the turns leave open {words}" for words in open_gains),
            *(differing(*products, names) if products else ()),
        ),
        advice=(*_advice(result, open_gains), *rests.advice),
        limits=_limits(request, error, rests.errors[0]),
        notes=(*rests.notes, *_notes(result)),
        weak=bool(open_gains),
    )
    details = imu_details(result)
    calibration = imu_calibration(result, outcome, details)
    sessions = None
    if products:
        sessions = _sessions(result.fit, products, names, calibration)
        between = sessions.describe()
        details = replace(details, between_sessions=between)
        facts = {**calibration.facts, "between_sessions": between.as_dict()}
        calibration = replace(calibration, facts=facts)
    return ImuRun(
        outcome=outcome,
        calibration=calibration,
        details=details,
        result=result,
        request=request,
        sessions=sessions,
    )


def _sessions(
    fit: TurnFit, products: tuple[Array, Array], names: tuple[str, ...], made: Calibration
) -> Sessions:
    """What power-ups do to the bias that a calibration states."""
    stated = {p.name: (p.name, p.value, p.sd) for p in made.parameters if p.effect == "bias"}
    own = {e: [p.value for p in made.parameters if p.effect == e] for e in _LINEAR}
    sensitivity = np.diag(1.0 + np.array(own["scale"]))
    sensitivity[[1, 2, 2], [0, 0, 1]] = own["non_orthogonality"]
    slope = sensitivity @ fit.state.lower * made.gravity / MG
    sd = float(fit.noise.power_up * np.mean(np.diag(slope)))
    what = ("session bias", "bias", "mg")
    between, after = estimate_scatter(what, bias_parts(*products, slope), sd, list(stated.values()))
    return Sessions(names, (between,), after)


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
    steps, unnamed = _steps(result), _nameless_laws(result)
    names, refused = tuple(s.effect for s in steps), result.refused
    turns = "nothing missing"
    if unnamed:
        turns = "explained in part" if steps and not refused else "unexplained"
    if steps:
        turns = turns if gained.proved else "suspected"
        turns = "explained" if turns == "nothing missing" else turns
    verdict = max(rests.verdict, turns, key=_VERDICTS.index)
    if {rests.verdict, turns} == {"explained", "unexplained"}:
        verdict = "explained in part"
    gain, noise = rests.gain, result.fit.noise
    if names:
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
        steps=(*(() if refused else steps), *rests.steps),
        rejected=(*rests.rejected, *((n, _NEEDLESS) for n in names if refused)),
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
        complete=rests.complete * result.found.said.complete,
        facts=(*rests.facts, ("turns", words)),
    )


def _steps(result: ImuResult) -> tuple[FoundStep, ...]:
    """What the turns show and that has a name."""
    components, gained = result.found.problem.components, result.held_out.gained
    check = CheckedError("held-out error, rms", "deg", gained.before, gained.after, 3)
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


def _nameless_laws(result: ImuResult) -> tuple[Unexplained, ...]:
    """What the turns show and that has no name."""
    components = result.found.problem.components
    return tuple(
        Unexplained(
            name=components[place.component].name,
            follows=components[place.component].follows,
            kind="probe",
            probability=place.probability,
            evidence=0.0,
            rivals=tuple(components[c].name for c, _ in place.rivals),
        )
        for place in result.found.said.places
        if not components[place.component].named
    )


def _scores(result: ImuResult) -> list[Score]:
    found = result.found
    evidence, inside = of_each(found.posterior, len(found.problem.components))
    return [
        Score(
            name=c.name,
            kind="effect" if c.named else "probe",
            follows=c.follows,
            evidence=float(evidence[k]),
            probability=float(inside[k]),
            left=found.problem.seen[k][0],
            strength=found.problem.seen[k][1],
        )
        for k, c in enumerate(found.problem.components)
    ]


def _limits(request: ImuRequest, error: ErrorSummary, rests: ErrorSummary) -> tuple[Limit, ...]:
    of = {"max-error": error, "max-force-error": rests}
    each = ((name, limit, of[name]) for name, limit in request.limits.items())
    return tuple(Limit(n, one.held_out.final, limit, one.unit) for n, limit, one in each)


def _advice(result: ImuResult, open_gains: tuple[str, ...]) -> tuple[str, ...]:
    """What next: what the turns leave open, or how the gains become better."""
    if open_gains:
        return (f"Turn about other axes: {_PLAN}.",)
    lost = result.imu.left_out
    words = (f"Record again what was left out: {lost[0]}.",) if lost else ()
    few = len(result.imu.turns.turns) < 12
    return (*words, *((f"Take more turns, a dozen or two: {_PLAN}.",) if few else ()))


def _notes(result: ImuResult) -> tuple[str, ...]:
    unseen = (
        "gravity does not show a turn about the vertical, nor a filter of the gyroscope: a motion "
        "from rest to rest turns the same angle"
    )
    lost = result.imu.left_out
    refused = [s.effect for s in _steps(result)] if result.refused else []
    said = [f"{in_words(n)} is there, and {_NEEDLESS}; --declare {n} puts it in" for n in refused]
    return (unseen, *said, *((f"{len(lost)} turns were left out", *lost) if lost else ()))


#: Effects of the accelerometer that the turns bear on.
_LINEAR = ("bias", "scale", "non_orthogonality")
#: Relative step of a derivative.
_STEP = 1e-6


def imu_calibration(result: ImuResult, outcome: Outcome, details: ImuDetails) -> Calibration:
    """The accelerometer's calibration as the turns leave it, with the gyroscope's parameters."""
    from scipy.linalg import block_diag

    made, fit = result.accelerometer.calibration, result.fit
    linear = np.isin([p.effect for p in made.parameters], _LINEAR)
    own, others = np.flatnonzero(linear), np.flatnonzero(~linear)
    theta = np.array([made.parameters[int(k)].value for k in own])
    moved, slopes = _linear(theta, fit, made.gravity)
    last = fit.state.first_up - 3
    kept = np.r_[: ACCELEROMETER + GAIN + fit.state.theta.size, last : last + 3]
    joint, rest = fit.covariance[np.ix_(kept, kept)], made.covariance[np.ix_(others, others)]
    turn = np.eye(kept.size + others.size)
    turn[:ACCELEROMETER, :ACCELEROMETER] = slopes
    turn[kept.size - 3 : kept.size] /= DEG
    # What other effects are off by moves the linear ones with them.
    shared = made.covariance[np.ix_(others, own)]
    turn[:ACCELEROMETER, kept.size :] = np.linalg.lstsq(rest, shared, rcond=None)[0].T
    covariance = turn @ block_diag(joint, rest) @ turn.T
    sd = np.sqrt(np.diag(covariance))
    accelerometer = [
        replace(made.parameters[int(k)], value=float(v), sd=float(s))
        for k, v, s in zip(own, moved, sd, strict=False)
    ]
    parameters = (
        *accelerometer,
        *(made.parameters[int(k)] for k in others),
        *_gyro_parameters(result, sd[ACCELEROMETER : kept.size]),
    )
    order = np.r_[:ACCELEROMETER, kept.size : len(turn), ACCELEROMETER : kept.size]
    covariance = covariance[np.ix_(order, order)]
    return replace(
        made,
        calibrator="imu",
        parameters=parameters,
        covariance=0.5 * (covariance + covariance.T),
        status=outcome.status,
        reasons=(*outcome.reasons, *map(str, outcome.undecided)),
        facts={
            **{k: v for k, v in made.facts.items() if k not in ("errors", "provenance")},
            "errors": [error.as_dict() for error in outcome.errors],
            "imu": details.imu.as_dict(),
            "noise_density": {"imu0": dict(details.noise_density)},
            "provenance": outcome.provenance.as_dict(),
        },
    )


def _linear(theta: Array, fit: TurnFit, gravity: float) -> tuple[Array, Array]:
    """(9,) bias (mg), scale and cross terms of the readings, by those (9,) of the readings that the
    turns were fitted to: S f + c with f as L (f' - b) leaves it; and (9, 9) their slopes by b and
    `LOWER`."""
    sensitivity = np.diag(1.0 + theta[3:6])  # as the effects have it
    sensitivity[[1, 2, 2], [0, 0, 1]] = theta[6:9]

    def of(x: Array) -> Array:
        lower = np.zeros((3, 3))
        lower[tuple(zip(*LOWER, strict=True))] = x[3:]
        whole = sensitivity @ np.linalg.inv(lower)
        bias = theta[:3] + sensitivity @ x[:3] * gravity / MG
        return np.array([*bias, *(np.diag(whole) - 1.0), whole[1, 0], whole[2, 0], whole[2, 1]])

    here = np.array([*fit.state.bias, *(fit.state.lower[at] for at in LOWER)])
    start = of(here)
    steps = _STEP * np.eye(ACCELEROMETER)
    return start, np.stack([(of(here + step) - start) / _STEP for step in steps], axis=1)


def _gyro_parameters(result: ImuResult, sd: Array) -> list[StoredParameter]:
    state = result.fit.state
    names = [(f"gyro_gain_{a}{b}", GAIN_EFFECT, "1") for a in "xyz" for b in "xyz"]
    for term in () if result.refused else result.found.terms:
        each = [term.effect.each[int(k)] for k in term.own]
        names += [(p.name, term.name, p.unit) for p in each]
    names += [(f"gyro_rest_bias_{a}", BIAS, "deg/s") for a in "xyz"]
    values = np.r_[state.gain.ravel(), state.theta, state.drift[-1] / DEG]
    return [
        StoredParameter(name, effect, STAGE, float(v), float(s), unit)
        for (name, effect, unit), v, s in zip(names, values, sd, strict=True)
    ]


def imu_details(result: ImuResult) -> ImuDetails:
    """What only an IMU has to say."""
    imu, fit, held = result.imu, result.fit, result.held_out
    blocks = noise_blocks(result.noise).values()
    return ImuDetails(
        **vars(result.accelerometer.details),
        imu=ImuFacts(
            frame="of the accelerometer: x along its x axis, y in the plane of its x and y",
            sample_interval_s=1.0 / result.noise[0].rate if result.noise else None,
            turns=len(imu.turns.turns),
            turns_left_out=tuple(imu.left_out),
            rests=imu.turns.rests,
            gyroscope_noise=_gyro_noise(result.noise),
            bias_walk_deg_per_s_per_root_s=fit.noise.walk / DEG,
            gyroscope_late_s=ValueSd(*lateness(fit)),
            turn_floor_deg=fit.noise.floor / DEG,
            turn_error_per_angle=fit.noise.per_angle,
        ),
        noise_density={key: value for block in blocks for key, value in block.items()},
        held_out_turns_deg=TurnErrors(held.raw, held.base, held.final),
    )


def _gyro_noise(noise: Sequence[SensorNoise]) -> GyroscopeNoise:
    axes = next((s.axes for s in noise if s.quantity == "angular_rate"), ())
    white, slow = [axis.white for axis in axes], [axis.instability for axis in axes]
    return GyroscopeNoise(
        rest_s=max((axis.curve.longest for axis in axes), default=0.0),
        white_deg_per_s_per_root_hz=tuple((w.value or w.below) / DEG for w in white),
        white_sd=tuple(
            (w.high - w.low) / (2.0 * _NORMAL_95 * DEG) if w.low and w.high else None for w in white
        ),
        bias_instability_deg_per_s=tuple((b.value or b.below) / DEG for b in slow),
        upper_limit=any(b.value is None for b in slow),
    )
