"""A finished calibration of one IMU: judged, in the words of all calibrators."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.findings import Findings, Gain, Untestable, findings_of
from imucalib.calibration.gyroscope import BIAS, STAGE
from imucalib.calibration.gyroscope import GAIN as GAIN_EFFECT
from imucalib.calibration.outcome import ErrorSummary, HeldOutError, Left, Limit, Outcome, Run
from imucalib.calibrators.imu.calibrate import ImuResult, calibrate_imu
from imucalib.calibrators.imu.plan import open_words
from imucalib.calibrators.imu.power_ups import bias_parts, describe_differing, products_of
from imucalib.calibrators.imu.request import ImuRequest
from imucalib.calibrators.lab.run import LabDetails
from imucalib.calibrators.sessions import BetweenSessions, estimate_scatter
from imucalib.core.fit import StoredParameter
from imucalib.core.sphere import even_directions
from imucalib.data import Data
from imucalib.effects.forms import in_words
from imucalib.estimators.lateness import lateness
from imucalib.estimators.turns import ACCELEROMETER, GAIN, LOWER, TurnFit, rest_forces
from imucalib.inspection.noise import SensorNoise, noise_blocks
from imucalib.posterior.closed_loop.found import CheckedError, Loop, Step
from imucalib.posterior.closed_loop.words import scores_of
from imucalib.recording.mapping import FieldMapping
from imucalib.significant_digits import plus_minus
from imucalib.units import DEG, MG

_NORMAL_95 = 1.96
#: Why what was found in the turns is not corrected.
_NEEDLESS = "not corrected: turns held out are no better with it"
_PLAN = (
    "turn by 135 deg about x, y and z in turn, every second round backwards, with 2 s of rest on "
    "something hard between"
)

#: Relative step of a derivative.
_STEP = 1e-6
#: Parameters of the accelerometer that the joint fit has first.
_LINEAR = (
    *(f"bias_{a}" for a in "xyz"),
    *(f"scale_{a}" for a in "xyz"),
    *(f"cross_{pair}" for pair in ("yx", "zx", "zy")),
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


def run_imu(
    paths: Sequence[Path], mapping: FieldMapping, request: ImuRequest, say: Callable[[str], None]
) -> ImuRun:
    """From logs to a run. Errors as in `calibrate_imu`."""
    result = calibrate_imu(paths, mapping, request, say)
    rests = result.accelerometer.outcome
    open_gains = open_words(result.fit.gains[:GAIN, :GAIN])
    errors, names = _errors(result), result.accelerometer.table.sessions
    products = products_of(result.fit) if names else None
    samples = sum(max(len(c.t) for c in r.channels.values()) for r in result.recordings)
    both = rests.fit is not None and rests.fit.converged and result.fit.converged
    findings = _findings(result, request)
    outcome = replace(
        rests,
        calibrator="imu",
        errors=errors,
        provenance=replace(rests.provenance, samples=samples, settings=request.describe_settings()),
        findings=findings,
        fit=rests.fit and replace(rests.fit, converged=both),
        reasons=(
            *rests.reasons,
            *(f"the turns leave open {words}" for words in open_gains),
            *(describe_differing(*products, names) if products else ()),
        ),
        advice=(*_advice(result, open_gains), *rests.advice),
        limits=_limits(request, errors),
        notes=(*rests.notes, *_notes(result)),
        weak=bool(open_gains),
        left=_list_open(result, findings),
    )
    details = imu_details(result)
    calibration = imu_calibration(result, outcome, details)
    if products:
        between = _sessions(result.fit, products, names, calibration)
        details = replace(details, between_sessions=between)
        facts = {**calibration.facts, "between_sessions": between.as_dict()}
        calibration = replace(calibration, facts=facts)
    return ImuRun(
        outcome=outcome,
        calibration=calibration,
        details=details,
        result=result,
        request=request,
    )


def _sessions(
    fit: TurnFit, products: tuple[Array, Array], names: tuple[str, ...], made: Calibration
) -> BetweenSessions:
    """What power-ups do to the bias that a calibration states."""
    stated = [(p.name, p.value, p.sd) for p in made.parameters if p.effect == "bias"]
    mg = made.gravity / MG
    parts = bias_parts(*products, mg)
    scatter, after = estimate_scatter("session bias", "mg", parts, mg * fit.noise.power_up, stated)
    return BetweenSessions(names, (scatter,), after)


def _errors(result: ImuResult) -> tuple[ErrorSummary, ErrorSummary]:
    """Of gravity carried over turns, and of its size at the rests."""
    held, log = result.held_out, result.imu.turns
    noisy = log.white * np.sqrt(np.mean(log.spans[1]))
    known = log.force_sd[np.isfinite(log.force_sd)]
    floors = (float(np.hypot(noisy, np.sqrt(2.0) * np.mean(known)) / DEG), float("nan"))
    metrics = (("gravity carried over a turn, rms", "deg"), ("error of |a|, rms", "mg"))
    pairs = ((result.turns, held.turns), (result.forces, held.forces))
    turns, forces = (
        ErrorSummary(metric, unit, *fitted.sizes, floor, HeldOutError(*out.sizes))
        for (metric, unit), floor, (fitted, out) in zip(metrics, floors, pairs, strict=True)
    )
    return turns, forces


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
    by_size = result.by_size.outcome.findings
    if not request.loop or by_size is None:
        return Findings("not run", only=request.only, without=request.without)
    loop, noise, stored = _loop(result), result.fit.noise, result.found.said.problem.absorbed
    words = (
        f"off by {noise.floor / DEG:.2g} deg and {100.0 * noise.per_angle:.2g} % of the angle "
        f"each; bias walk {float(np.mean(noise.walk)) / DEG:.2g} deg/s per root s"
    )
    return findings_of(
        loop,
        lambda _: (),
        missing={**by_size.missing, **loop.missing},
        not_testable=tuple(Untestable(n, "a typical size", 0.0, "deg") for n in stored),
        declared=tuple((n, "") for n in request.declare),
        only=request.only,
        without=request.without,
        gain=_gain(result) if loop.steps or loop.refuted else None,
        facts=(("turns", words),),
    )


def _loop(result: ImuResult) -> Loop[TurnFit]:
    """The search over both sensors."""
    found, held = result.found, result.held_out
    problem, said, steps = found.said.problem, found.said, _steps(result)
    components = problem.components
    nameless = (place for place in said.places if not components[place.component].named)
    refused = tuple(step.effect for step in steps) if result.refused else ()
    shown = [(*seen, 0.0) for seen in problem.seen]
    return Loop(
        base=found.base,
        final=result.fit,
        steps=() if result.refused else steps,
        rejected=tuple((name, _NEEDLESS) for name in refused),
        refuted=refused,
        unexplained=tuple(
            said.leave_unexplained(p, lambda c: problem.components[c].name) for p in nameless
        ),
        scores=scores_of(problem, found.said.posterior, shown),
        missing=found.lacking.missing,
        difference=next((d for d in (held.of_turns, held.of_forces) if d.proved), held.gained),
        complete=said.complete,
    )


def _list_open(result: ImuResult, findings: Findings) -> tuple[Left, ...]:
    """By how much what is not settled changes a force, against what the calibration is good to."""
    base, final = (rest_forces(fit) for fit in (result.found.base, result.found.final))
    moved = np.sqrt(np.mean(np.sum((final - base) ** 2, axis=1)))
    size = float(moved * result.imu.course.gravity / MG)
    if not size or not (result.refused or findings.verdict == "suspected"):
        return ()
    accepted = result.held_out.forces.sizes[2]
    return (Left("what stays open in a reading", size, accepted, "mg"),)


def _gain(result: ImuResult) -> Gain:
    """Of the sensor that more was gained of, in its unit."""
    held = result.held_out
    each = ((held.of_turns, "deg"), (held.of_forces, "mg"))
    one, unit = min(each, key=lambda pair: pair[0].after / max(pair[0].before, 1e-12))
    return Gain(one.before, one.after, one.low, one.high, one.proved, unit)


def _steps(result: ImuResult) -> tuple[Step, ...]:
    """What the log shows and a calibration can state."""
    found, held = result.found, result.held_out
    said, sizes, steps = found.said, _sizes(result), []
    for place in said.places:
        if not found.said.problem.corrects(place.component):
            continue
        effect = said.member(place.component).effects[0][0]
        of_rate = effect.channel == "angular_rate"
        one, unit = (held.of_turns, "deg") if of_rate else (held.of_forces, "mg")
        check = CheckedError("held-out error, rms", unit, one.before, one.after, 3)
        rivals = tuple((_name(result, c), share) for c, share in place.rivals)
        steps.append(said.step(place, (check,), rivals, sizes.get(effect.name, "")))
    return tuple(steps)


def _name(result: ImuResult, component: int) -> str:
    """The effect of a component where it is told or likeliest, its own name where it has none."""
    found = result.found
    if not found.said.problem.corrects(component):
        return found.said.problem.components[component].name
    return found.said.name(component)


def _sizes(result: ImuResult) -> dict[str, str]:
    """Found effects' numbers in words, by name."""
    final, sized = result.found.final, dict[str, str]()
    sd = np.sqrt(np.diag(final.gains))[GAIN:]
    numbers = iter(zip(final.state.theta.tolist(), sd.tolist(), strict=True))
    for term in result.found.terms:
        every = term.effect.parameters(result.imu.course.rests)
        words = (
            f"{every[int(k)].name.rpartition('_')[2]} {plus_minus(*next(numbers), p.unit)}"
            for k in term.own
            for p in (every[int(k)],)
        )
        sized[term.name] = ", ".join(words)
    return sized


def _limits(request: ImuRequest, errors: tuple[ErrorSummary, ErrorSummary]) -> tuple[Limit, ...]:
    of = dict(zip(("max-error", "max-force-error"), errors, strict=True))
    each = ((name, limit, of[name]) for name, limit in request.limits.items())
    return tuple(Limit(n, one.held_out.final, limit, one.unit) for n, limit, one in each)


def _advice(result: ImuResult, open_gains: tuple[str, ...]) -> tuple[str, ...]:
    """What next: what the turns leave open, or how the gains become better."""
    if open_gains:
        return (f"Turn about other axes: {_PLAN}.",)
    lost = (*result.by_size.details.left_out, *result.imu.left_out)
    words = (f"Record again what was left out: {lost[0]}.",) if lost else ()
    few = len(result.imu.turns.turns) < 12
    return (*words, *((f"Take more turns, a dozen or two: {_PLAN}.",) if few else ()))


def _notes(result: ImuResult) -> tuple[str, ...]:
    unseen = (
        "gravity does not show a turn about the vertical, nor a filter of the gyroscope: a motion "
        "from rest to rest turns the same angle"
    )
    lost = result.imu.left_out
    rests = result.by_size.details.left_out
    refused = [s.effect for s in _steps(result)] if result.refused else []
    said = [f"{in_words(n)} is there, and {_NEEDLESS}; --declare {n} puts it in" for n in refused]
    return (
        unseen,
        *said,
        *((f"{len(rests)} rests were left out", *rests) if rests else ()),
        *((f"{len(lost)} turns were left out", *lost) if lost else ()),
    )


def imu_calibration(result: ImuResult, outcome: Outcome, details: ImuDetails) -> Calibration:
    """The accelerometer's calibration, with the gyroscope's parameters after it."""
    made, fit = result.accelerometer.calibration, result.fit
    last = fit.state.first_up - 3
    kept = np.r_[: fit.state.first_offset, last : last + 3]
    linear, slopes = _linear(fit, made.gravity)
    turn = np.eye(kept.size)
    turn[:ACCELEROMETER, :ACCELEROMETER] = slopes
    turn[-3:] /= DEG
    joint = turn @ fit.covariance[np.ix_(kept, kept)] @ turn.T
    values = np.r_[linear, fit.state.gain.ravel(), fit.state.theta, fit.state.drift[-1] / DEG]
    names, order = _order(result, made)
    there, at = np.array(order) >= 0, np.maximum(order, 0)
    covariance = np.where(np.outer(there, there), joint[np.ix_(at, at)], 0.0)
    stored = np.where(there, values[at], 0.0)
    parameters = tuple(
        replace(one, value=float(value), sd=float(sd))
        for one, value, sd in zip(names, stored, np.sqrt(np.diag(covariance)), strict=True)
    )
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


def _linear(fit: TurnFit, gravity: float) -> tuple[Array, Array]:
    """(9,) bias (mg), scale and cross terms of readings a = S f + c with f = L (a - b), and (9, 9)
    their slopes by b and `LOWER`."""

    def of(x: Array) -> Array:
        lower = np.zeros((3, 3))
        lower[tuple(zip(*LOWER, strict=True))] = x[3:]
        whole = np.linalg.inv(lower)
        bias = x[:3] * gravity / MG
        return np.array([*bias, *(np.diag(whole) - 1.0), whole[1, 0], whole[2, 0], whole[2, 1]])

    here = np.array([*fit.state.bias, *(fit.state.lower[at] for at in LOWER)])
    start = of(here)
    steps = _STEP * np.eye(ACCELEROMETER)
    return start, np.stack([(of(here + step) - start) / _STEP for step in steps], axis=1)


def _order(result: ImuResult, made: Calibration) -> tuple[list[StoredParameter], list[int]]:
    """The accelerometer's parameters as its bench has them and then the gyroscope's, and where each
    stands in the joint fit, -1 where it does not."""
    rests, at = result.imu.course.rests, ACCELEROMETER + GAIN
    place, turning = {name: k for k, name in enumerate(_LINEAR)}, list[StoredParameter]()
    terms = result.found.declared if result.refused else result.found.terms
    for term in terms:
        every = term.effect.parameters(rests)
        for k in term.own:
            one = every[int(k)]
            place[one.name] = at
            if term.of_rate:
                turning.append(StoredParameter(one.name, term.name, STAGE, 0.0, 0.0, one.unit))
            at += 1
    gains = [
        StoredParameter(f"gyro_gain_{a}{b}", GAIN_EFFECT, STAGE, 0.0, 0.0, "1")
        for a in "xyz"
        for b in "xyz"
    ]
    biases = [StoredParameter(f"gyro_rest_bias_{a}", BIAS, STAGE, 0.0, 0.0, "deg/s") for a in "xyz"]
    place.update({one.name: ACCELEROMETER + k for k, one in enumerate(gains)})
    place.update({one.name: at + k for k, one in enumerate(biases)})
    names = [*made.parameters, *gains, *turning, *biases]
    return names, [place.get(one.name, -1) for one in names]


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
        held_out_turns_deg=TurnErrors(held.turns.raw, held.turns.base, held.turns.final),
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
