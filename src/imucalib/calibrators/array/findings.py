"""The array's search in the words of all searches: the one place where its loop is read for them.

What a reading of the loop needs beyond `Findings` is here too: errors before and after, what the
calibrated array leaves unexplained in the terms of who uses it (mm, mg and deg/s), and the noise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import stored_parameters
from imucalib.calibration.findings import Findings, Gain, Untestable, findings_of
from imucalib.calibration.outcome import ErrorSummary, HeldOutError, Left
from imucalib.calibrators.array.board.catalogue import array_catalogue
from imucalib.calibrators.array.board.rests import RestFit
from imucalib.calibrators.array.motion.closed_loop import (
    NORMAL_MAD,
    Gained,
    MotionLoop,
    size_in_words,
)
from imucalib.calibrators.array.motion.covariance import POSITIONS, Uneven
from imucalib.calibrators.array.motion.effect_blocks import AT_REST, parameters_of
from imucalib.calibrators.array.motion.state import ArrayState
from imucalib.calibrators.array.motion.terms import typical_of
from imucalib.calibrators.array.request import Accepted
from imucalib.core.fit import StoredParameter
from imucalib.effects.forms import in_words
from imucalib.estimators.array.noise import MotionNoise
from imucalib.posterior.closed_loop.found import Step
from imucalib.units import DEG, MG

_COUNTS = 0.5  # of an effect's typical size, from which it asks for something to be done
#: Times the others' noise or residual from which an IMU stands out.
NOISY = 2.0
_NAN = float("nan")


@dataclass(frozen=True)
class Residual:
    """1.4826 times the median absolute deviation in motion: acceleration (m/s²), rate (rad/s);
    held_out : whether of motion that took no part in any choice; each : (K,) of each IMU, of the
    fit"""

    acceleration: float
    rate: float
    held_out: bool
    each: tuple[Array, Array]


def residual_in_motion(loop: MotionLoop | None, state: ArrayState) -> Residual:
    """Held out where there is such motion; else of the fit."""
    inner, off, kept = state.setup.inner, state.sampled.off, state.sampled.kept
    # Each over the share of its variance that the motion leaves it.
    force, rate = (
        np.abs(values[inner]) / np.sqrt(share.share[inner])[..., None]
        for values, share in zip(off, kept, strict=True)
    )
    each = (
        np.asarray(NORMAL_MAD * np.median(force, axis=(0, 2))),
        np.asarray(NORMAL_MAD * np.median(rate, axis=(0, 2))),
    )
    if loop is not None and loop.held_out is not None:
        _, after = loop.held_out
        held = NORMAL_MAD * after.acceleration, NORMAL_MAD * after.rate * DEG
        return Residual(*held, held_out=True, each=each)
    one, two = (float(NORMAL_MAD * np.median(v)) for v in (force, rate))
    return Residual(one, two, held_out=False, each=each)


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
    each = residual.each
    for sensor, size, own, still, (unit, limit, name) in (
        ("accelerometer", residual.acceleration, each[0], rests.noise, (MG, accepted.mg, "mg")),
        ("gyro", residual.rate, each[1], rests.gyro_noise, (DEG, accepted.deg_per_s, "deg/s")),
    ):
        noise = float(np.sqrt(np.mean(still**2)))
        whole.append(Left(f"{sensor}s in motion", _subtract_noise(size, noise) / unit, limit, name))
        for k, imu in enumerate(imus):
            # One of many moves no median. What it leaves is held against the others' noise at rest,
            # for noise of its own is no less left for being there at rest too.
            alone = _subtract_noise(float(own[k]), float(np.median(np.delete(still, k)))) / unit
            if own[k] >= NOISY * float(np.median(np.delete(own, k))) and alone > limit:
                single.append(Left(f"{sensor} of {imu} in motion", alone, limit, name))
    if isinstance(found, Uneven):
        moved = 1e3 * float(found.spread.max())
        return (Left(POSITIONS + found.follows, moved, accepted.mm, "mm"), *whole, *single)
    if found is None:
        return (*whole, *single)
    moves = list(found.moved.values())
    if found.suspected:
        # What is corrected and not proved could as well not be.
        moves.append(float(np.sqrt(np.mean((found.final.r - found.base.r)[1:] ** 2))))
    moved = 1e3 * max(moves, default=0.0)
    return (Left("positions", moved, accepted.mm, "mm"), *whole, *single)


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
    a, g = loop.final.noise
    imus = loop.final.setup.imus
    return (
        *_alone(loop),
        *_noisy(imus, "accelerometer", a, rests.noise, (1.0, "m/s²")),
        *_noisy(imus, "gyro", g, rests.gyro_noise, (DEG, "deg/s")),
    )


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
    imus: tuple[str, ...], sensor: str, noise: MotionNoise, still: Array, unit: tuple[float, str]
) -> Iterator[str]:
    """noise : in motion; still : (K,), at rest; unit : its size in SI, and its name"""
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
        size = noise.sigma * noise.factor[k] / unit[0]
        yield (
            f"In motion the {sensor} of {imu} is {times:.1f} times noisier than the others "
            f"({size:.2g} {unit[1]}), {cause}. It counts by that much less."
        )


def array_findings(loop: MotionLoop) -> Findings:
    """The search as all calibrators report it."""
    a, g = loop.final.noise
    steps = tuple(replace(step, size=_final_size(step, loop)) for step in loop.steps)
    return findings_of(
        replace(loop, steps=steps),
        lambda step: _parameters(step, loop),
        verdict=loop.verdict if loop.scope.search else "not run",
        gain=_gain(loop),
        not_testable=tuple(_untestable(name, m) for name, m in loop.impact.items()),
        declared=tuple(
            (t.name, size_in_words(loop.final, t))
            for t in loop.final.found
            if t.name in loop.scope.declare
        ),
        only=loop.scope.only,
        without=loop.scope.without,
        facts=(
            ("accelerometer noise", _noise_words(a, 1.0, "m/s²")),
            ("gyro noise", _noise_words(g, DEG, "deg/s")),
            *_gains(loop.gained),
            ("shared by neighbours", f"{loop.dispersion:.2f} times fewer samples"),
        ),
    )


def _gain(loop: MotionLoop) -> Gain | None:
    """Of the sensor that decided, in the unit of its error."""
    d, found = loop.difference, loop.gained
    if d is None or found is None:
        return None
    scale, unit = (DEG, "deg/s") if d is found.rate else (1.0, "m/s²")
    before, after, low, high = (v / scale for v in (d.before, d.after, d.low, d.high))
    return Gain(before, after, low, high, d.proved, unit)


def _gains(found: Gained | None) -> tuple[tuple[str, str], ...]:
    """What each sensor has gained, with its interval."""
    if found is None:
        return ()
    sensors = (
        ("accelerometers", found.acceleration, 1.0, "m/s²"),
        ("gyros", found.rate, DEG, "deg/s"),
    )
    return tuple(
        (
            f"held-out gain, {name}",
            f"{d.gain / scale:.3g} {unit}, 95 % {d.low / scale:.3g} to {d.high / scale:.3g}, "
            f"{d.parts} blocks",
        )
        for name, d, scale, unit in sensors
    )


def _parameters(step: Step, loop: MotionLoop) -> Iterator[StoredParameter]:
    """Of a step's effect in the final model."""
    for term in loop.final.found:
        if term.name == step.effect:
            yield from parameters_of(loop, term)
    if step.effect.startswith(AT_REST) and loop.rests is not None:
        name = step.effect.removeprefix(AT_REST)
        yield from (p for p in stored_parameters(loop.rests.final) if p.effect == name)


def _final_size(step: Step, loop: MotionLoop) -> str:
    """Its size in the final model, in words; of what that does not hold, as it was accepted."""
    sizes = (size_in_words(loop.final, t) for t in loop.final.found if t.name == step.effect)
    return next(sizes, step.size)


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
    held = ((_NAN, _NAN), (_NAN, _NAN))
    if loop is not None and loop.held_out is not None:
        before, after = loop.held_out
        held = (before.acceleration, after.acceleration), (before.rate, after.rate)
    found = []
    for sensor, value, (size, name), still, taken, gains in (
        ("accelerometer", residual.acceleration, (1.0, "m/s²"), rests.noise, 2.0, held[0]),
        ("gyro", residual.rate, (DEG, "deg/s"), rests.gyro_noise, 1.0, held[1]),
    ):
        final = _NAN if residual.held_out else value / size / NORMAL_MAD
        noise = float(np.sqrt(np.mean(still**2))) / size / NORMAL_MAD
        found.append(
            ErrorSummary(
                metric=f"{sensor} residual in motion, MAD",
                unit=name,
                raw=_NAN,
                base=final if loop is None else _NAN,
                final=final,
                floor=float(noise * np.sqrt(1.0 - taken / len(still))),
                held_out=HeldOutError(_NAN, *gains),
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
