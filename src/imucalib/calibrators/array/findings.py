"""The array's search in the words of all searches: the one place where its loop is read for them.

What a reading of the loop needs beyond `Findings` is here too: errors before and after, what the
calibrated array leaves unexplained in the terms of who uses it (mm, mg and deg/s), and the noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import stored_parameters
from imucalib.calibration.findings import Findings, Gain, Untestable, findings_of
from imucalib.calibration.outcome import ErrorSummary, HeldOutError, Left
from imucalib.calibration.triads import triangle
from imucalib.calibrators.array.board.rests import BASE, RestFit
from imucalib.calibrators.array.motion.ages import beats
from imucalib.calibrators.array.motion.closed_loop import (
    NORMAL_MAD,
    Gained,
    MotionLoop,
)
from imucalib.calibrators.array.motion.covariance import Uneven
from imucalib.calibrators.array.motion.laws import AT_REST, array_catalogue
from imucalib.calibrators.array.motion.state import ArrayState, size_in_words
from imucalib.calibrators.array.motion.terms import Term, typical_of
from imucalib.calibrators.array.request import Accepted
from imucalib.core.effect import Effect
from imucalib.core.fit import StoredParameter
from imucalib.effects.forms import in_words
from imucalib.effects.record_error import is_record_error
from imucalib.estimators.array.noise import MotionNoise
from imucalib.estimators.array.samples import Pair
from imucalib.posterior.closed_loop.found import Step
from imucalib.units import DEG, MG

_COUNTS = 0.5  # of an effect's typical size, from which it asks for something to be done
#: Kinds of sensors in the order of every pair, with the size and the name of their unit.
SENSORS = (("accelerometer", 1.0, "m/s²"), ("gyro", DEG, "deg/s"))
#: Times the others' noise or residual from which an IMU stands out.
NOISY = 2.0
_NAN = float("nan")
#: Share of an effect beyond its linear part from which on it counts.
_SMALL = 1e-6


@dataclass(frozen=True)
class Residual:
    """1.4826 times the median absolute deviation in motion: acceleration (m/s²), rate (rad/s);
    held_out : whether of motion that took no part in any choice; each : (K,) of each IMU, of the
    fit"""

    acceleration: float
    rate: float
    held_out: bool
    each: Pair


def residual_in_motion(loop: MotionLoop | None, state: ArrayState) -> Residual:
    """Held out where there is such motion; else of the fit."""
    inner, sampled = state.setup.inner, state.sampled
    # Each over the share of its variance that the motion leaves it.
    sizes = [
        np.abs(off[inner]) / np.sqrt(kept.share[inner])[..., None]
        for off, kept in zip(sampled.off, sampled.kept, strict=True)
    ]
    each = Pair(*(NORMAL_MAD * np.median(size, axis=(0, 2)) for size in sizes))
    held = None if loop is None else loop.held_out
    ends = [d.after for d in held] if held else [float(np.median(size)) for size in sizes]
    return Residual(NORMAL_MAD * ends[0], NORMAL_MAD * ends[1], held is not None, each)


def find_unexplained(
    residual: Residual,
    rests: RestFit,
    imus: tuple[str, ...],
    accepted: Accepted,
    found: MotionLoop | Uneven | None,
) -> tuple[Left, ...]:
    """Residuals beyond the noise at rest, those of an IMU that stands out by itself, and how far
    structure that is not explained would move the positions.

    found : what was searched; where nothing was, how parts of the motion differ
    """
    whole, single = [], []
    limits = (MG, accepted.mg, "mg"), (DEG, accepted.deg_per_s, "deg/s")
    sizes, stills = (residual.acceleration, residual.rate), (rests.noise, rests.gyro_noise)
    for (sensor, *_), size, own, still, (unit, limit, name) in zip(
        SENSORS, sizes, residual.each, stills, limits, strict=True
    ):
        noise = float(np.sqrt(np.mean(still**2)))
        whole.append(Left(f"{sensor}s in motion", _subtract_noise(size, noise) / unit, limit, name))
        for k, imu in enumerate(imus):
            # One of many moves no median. What it leaves is held against the others' noise at rest,
            # for noise of its own is no less left for being there at rest too.
            alone = _subtract_noise(float(own[k]), float(np.median(np.delete(still, k)))) / unit
            if own[k] >= NOISY * float(np.median(np.delete(own, k))) and alone > limit:
                single.append(Left(f"{sensor} of {imu} in motion", alone, limit, name))
    if found is None:
        return (*whole, *single)
    if isinstance(found, Uneven):
        name, moves = found.unexplained.name, [float(found.spread.max())]
    else:
        name, moves = "positions", list(found.moved.values())
        if found.suspected:
            # What is corrected and not proved could as well not be.
            moves.append(float(np.sqrt(np.mean((found.final.r - found.base.r)[1:] ** 2))))
    return (Left(name, 1e3 * max(moves, default=0.0), accepted.mm, "mm"), *whole, *single)


def _subtract_noise(size: float, noise: float) -> float:
    return float(np.sqrt(max(size**2 - noise**2, 0.0)))


def reasons(loop: MotionLoop | None, left: tuple[Left, ...]) -> tuple[str, ...]:
    """Why the result is not as good as it could be: what exceeds what is accepted, with the
    structure that is behind it; empty where nothing does."""
    found = [f"not explained: {one.sentence}" for one in left if one.beyond]
    if found and loop is not None and loop.unexplained:
        names = "; ".join(u.name for u in loop.unexplained)
        found.append(f"structure that no effect of the catalogue explains: {names}")
    return tuple(found)


def advice(loop: MotionLoop, rests: RestFit) -> tuple[str, ...]:
    """IMUs with an effect of their own, and chips that are noisier in motion than their neighbours,
    with what they are at rest."""
    imus, stills = loop.final.setup.board.imus, (rests.noise, rests.gyro_noise)
    every = zip(SENSORS, loop.final.noise, stills, strict=True)
    return (*_alone(loop), *(word for own in every for word in _noisy(imus, *own)))


def _alone(loop: MotionLoop) -> Iterator[str]:
    for term in loop.final.found:
        effect, at, imu = term.name.partition("@")
        remedy = term.effect.remedy
        typical = typical_of(term.effect, len(term.theta))
        counts = float(np.sqrt(np.mean((term.theta / typical) ** 2))) >= _COUNTS
        if at and remedy and counts:
            size = size_in_words(loop.final, term)
            yield f"{imu} alone has {in_words(effect)} ({size}): {remedy}. It is corrected here."


def _noisy(
    imus: tuple[str, ...], kind: tuple[str, float, str], noise: MotionNoise, still: Array
) -> Iterator[str]:
    """kind : of `SENSORS`; noise : in motion; still : (K,), at rest"""
    sensor, unit, unit_name = kind
    for k, imu in enumerate(imus):
        times = float(noise.factor[k] / np.median(np.delete(noise.factor, k)))
        if times < NOISY:
            continue
        own = float(still[k] / np.median(np.delete(still, k)))
        cause = (
            "so is it at rest: exchange the chip"
            if own > 0.5 * times
            else "not at rest: look for a loose mount or something that vibrates"
        )
        size = noise.sigma * noise.factor[k] / unit
        yield (
            f"In motion the {sensor} of {imu} is {times:.1f} times noisier than the others "
            f"({size:.2g} {unit_name}), {cause}. It counts by that much less."
        )


def array_findings(loop: MotionLoop) -> Findings:
    """The search as all calibrators report it."""
    sizes = {term.name: size_in_words(loop.final, term) for term in loop.final.found}
    # Of what the final model does not hold, as it was accepted.
    steps = (replace(step, size=sizes.get(step.effect, step.size)) for step in loop.steps)
    return findings_of(
        replace(loop, steps=tuple(steps)),
        lambda step: _parameters(step, loop),
        verdict=loop.verdict if loop.request.loop else "not run",
        gain=_gain(loop),
        not_testable=tuple(_untestable(name, m) for name, m in loop.impact.items()),
        declared=tuple((n, size) for n, size in sizes.items() if n in loop.request.declare),
        only=loop.request.only,
        without=loop.request.without,
        facts=(
            *(
                (f"{sensor} noise", _noise_words(noise, unit, name))
                for (sensor, unit, name), noise in zip(SENSORS, loop.final.noise, strict=True)
            ),
            *(_gain_words(loop.gained) if loop.gained else ()),
            ("shared by neighbours", f"{loop.dispersion:.2f} times fewer samples"),
        ),
    )


def _gain(loop: MotionLoop) -> Gain | None:
    """Of the sensor that decided, in the unit of its error."""
    d, found = loop.difference, loop.gained
    if d is None or found is None:
        return None
    _, scale, unit = SENSORS[d is found.rate]
    before, after, low, high = (v / scale for v in (d.before, d.after, d.low, d.high))
    return Gain(before, after, low, high, d.proved, unit)


def _gain_words(found: Gained) -> Iterator[tuple[str, str]]:
    """What each sensor has gained, with its interval."""
    for (sensor, unit, name), d in zip(SENSORS, found, strict=True):
        gain, low, high = (v / unit for v in (d.gain, d.low, d.high))
        words = f"{gain:.3g} {name}, 95 % {low:.3g} to {high:.3g}, {d.parts} blocks"
        yield f"held-out gain, {sensor}s", words


def _parameters(step: Step, loop: MotionLoop) -> Iterator[StoredParameter]:
    """Of a step's effect in the final model."""
    for term in loop.final.found:
        if term.name == step.effect:
            yield from parameters_of(loop, term)
    if step.effect.startswith(AT_REST) and loop.rests is not None:
        name = step.effect.removeprefix(AT_REST)
        yield from (p for p in stored_parameters(loop.rests.final) if p.effect == name)


def _untestable(name: str, impact: float) -> Untestable:
    parameter = array_catalogue()[name].each[0]
    return Untestable(name, f"{parameter.typical:g} {parameter.unit}", 1e3 * impact, "mm rms")


def array_errors(
    loop: MotionLoop | None, rests: RestFit, residual: Residual
) -> tuple[ErrorSummary, ...]:
    """Residuals of the accelerometers (m/s²), which are the principal ones, and the gyros (deg/s):
    held out, or of the fit where nothing was.

    The floor is set by a sample's noise at rest: of its 3 K numbers the motion takes 6 from the
    accelerometers (dω/dt and s) and 3 from the gyros (ω).
    """
    found = []
    sizes, stills = (residual.acceleration, residual.rate), (rests.noise, rests.gyro_noise)
    held = None if loop is None else loop.held_out
    for (sensor, unit, name), size, still, taken, own in zip(
        SENSORS, sizes, stills, (2.0, 1.0), held or (None, None), strict=True
    ):
        final = _NAN if residual.held_out else size / unit / NORMAL_MAD
        noise = float(np.sqrt(np.mean(still**2))) / unit / NORMAL_MAD
        apart = (own.before / unit, own.after / unit) if own else (_NAN, _NAN)
        found.append(
            ErrorSummary(
                metric=f"{sensor} residual in motion, MAD",
                unit=name,
                raw=_NAN,
                base=final if loop is None else _NAN,
                final=final,
                floor=float(noise * np.sqrt(1.0 - taken / len(still))),
                held_out=HeldOutError(_NAN, *apart),
            )
        )
    return tuple(found)


def _noise_words(noise: MotionNoise, unit: float, name: str) -> str:
    """The distribution in words."""
    words = f"{noise.sigma / unit:.3g} {name}"
    if noise.growth > 0.0:
        words += f" times sqrt(1 + (|ω| / {1.0 / noise.growth / DEG:.0f} deg/s)²)"
    if np.isfinite(noise.freedom):
        words += f", Student t of {noise.freedom:g} degrees of freedom"
    if noise.gained > 0.0:
        words += f"; held-out halves gain {noise.gained:.0f} nats by that shape"
    return words


def noise_block(loop: MotionLoop) -> dict[str, Any]:
    """Noise in motion, and the beats of the gyros' clocks, for report.json."""
    shapes = dict(zip(("accelerometer", "gyroscope"), loop.final.noise, strict=True))
    block: dict[str, Any] = {
        name: {
            "sigma_si": noise.sigma,
            "growth_s_per_rad": noise.growth,
            "student_t": noise.freedom,
            "factor_of_imu": noise.factor,
            "held_out_nats": noise.gained,
        }
        for name, noise in shapes.items()
    }
    block["shared_by_neighbours"] = loop.dispersion
    block["beats_hz"] = [] if loop.final.clock is None else loop.final.clock.frequency
    return block


def rest_blocks(rests: RestFit) -> list[dict[str, Any]]:
    """What was found at rest, with values, standard deviations and covariance."""
    fit, found = rests.fit, []
    slices, stored = fit.model.slices(fit.observations.context), stored_parameters(fit)
    for effect in fit.model.effects:
        if effect.name not in BASE and not is_record_error(effect.name):
            own, at = [p for p in stored if p.effect == effect.name], slices[effect.name]
            found.append(_block(AT_REST + effect.name, effect, own, fit.covariance[at, at]))
    return found


def effect_blocks(loop: MotionLoop) -> list[dict[str, Any]]:
    """Accepted effects with values, standard deviations and covariance."""
    found = []
    for term in loop.final.found:
        own, declared = list(parameters_of(loop, term)), term.name in loop.request.declare
        block = _block(term.name, term.effect, own, loop.final.covariance_of(term), declared)
        found.append({**_beats(loop, term), **block})
    return found


def _block(
    name: str,
    effect: Effect,
    parameters: Sequence[StoredParameter],
    covariance: Array,
    declared: bool = False,
) -> dict[str, Any]:
    return {
        "effect": name,
        "declared": declared,
        "channel": effect.channel,
        "equation": effect.equation,
        "parameters": [
            {"name": p.name, "unit": p.unit, "value": p.value, "sd": p.sd} for p in parameters
        ],
        "covariance": triangle(covariance),
    }


def parameters_of(loop: MotionLoop, term: Term) -> Iterator[StoredParameter]:
    """Values and standard deviations of a found effect."""
    state = loop.final
    for p, value, sd in zip(
        term.parameters(state.setup.board.imus), term.theta, state.sd_of(term), strict=True
    ):
        yield StoredParameter(p.name, term.name, "sensor", float(value), float(sd), p.unit)


def _beats(loop: MotionLoop, term: Term) -> dict[str, Any]:
    """Clocks of the gyros in this recording: they start anew with the power."""
    setup, clock = loop.final.setup, loop.final.clock
    if not term.aged or clock is None:
        return {}
    return {
        "beats": [
            None if beat is None else {"imu": imu, **vars(beat)}
            for imu, beat in zip(setup.board.imus, beats(clock, setup.t, setup.rows), strict=True)
        ]
    }


@dataclass(frozen=True)
class LinearPart:
    """What found effects add to a calibrated reading, to first order about rest.

    gain, offset : (K, 3, 3) and (K, 3) of the accelerometers, m/s²: reading = gain force + offset
    gyro_gain, gyro_offset : the same of the gyros, rad/s
    beyond : effects of which more remains, and its rms in this motion, with the unit
    """

    gain: Array
    offset: Array
    gyro_gain: Array
    gyro_offset: Array
    beyond: tuple[tuple[str, float, str], ...]


def linear_part(state: ArrayState) -> LinearPart:
    """The linear part of all found effects, in the middle of the motion."""
    setup, motion, beyond = state.setup, state.motion, []
    gains, offsets = (
        np.tile(np.eye(3), (2, setup.board.count, 1, 1)),
        np.zeros((2, setup.board.count, 3)),
    )
    middle = float(np.median(setup.t))
    for term in state.found:
        gain, offset = term.slope_at_rest(setup.board, middle)
        gains[int(term.gyro)] += gain
        offsets[int(term.gyro)] += offset
        more, whole = term.beyond(motion, gain, offset), term.reading(motion)
        rms, of = (float(np.sqrt(np.mean(v**2))) for v in (more, whole))
        if rms > _SMALL * of:
            size, unit = (DEG, "deg/s") if term.gyro else (1.0, "m/s²")
            beyond.append((term.name, rms / size, unit))
    return LinearPart(gains[0], offsets[0], gains[1], offsets[1], tuple(beyond))
