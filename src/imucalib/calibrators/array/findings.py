"""The array's search in the words of all searches: the one place where its loop is read for them.

What a reading of the loop needs beyond `Findings` stands here too: errors before and after, effects
with their values, and how much of them a linear correction carries.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.calibration.calibration import StoredParameter
from imucalib.calibration.findings import Check, Findings, FoundStep, Untestable
from imucalib.calibration.outcome import ErrorSummary, HeldOutError
from imucalib.calibrators.array.ages import beats
from imucalib.calibrators.array.found import CURVE, ArrayLoop, ArrayStep
from imucalib.calibrators.array.terms import Term
from imucalib.calibrators.array.worth import size_in_words
from imucalib.core.array_motion import ArrayMotion
from imucalib.effects.array import array_catalogue
from imucalib.estimators.array.noise import SensorNoise
from imucalib.units import DEG

Array = NDArray[np.float64]
_NORMAL_MAD = 1.4826
_NAN = float("nan")
_SMALL = 1e-6  # share of an effect beyond its linear part from which on it counts


def array_findings(loop: ArrayLoop) -> Findings:
    """The search as all calibrators report it."""
    a, g = loop.final.noise
    return Findings(
        verdict=loop.verdict if loop.asked.search else "not run",
        steps=tuple(_step(step, loop) for step in loop.steps),
        rejected=loop.rejected,
        unexplained=loop.unexplained,
        scores=loop.scores,
        missing=loop.missing,
        not_testable=tuple(_untestable(name, m) for name, m in loop.absorbed.items()),
        declared=tuple(
            (t.name, size_in_words(loop.final, t))
            for t in loop.final.found
            if t.name in loop.asked.declare
        ),
        only=loop.asked.only,
        without=loop.asked.without,
        facts=(
            ("accelerometer noise", _noise_words(a, 1.0, "m/s²")),
            ("gyro noise", _noise_words(g, DEG, "deg/s")),
            ("shared by neighbours", f"{loop.dispersion:.2f} times fewer samples"),
        ),
    )


def _step(step: ArrayStep, loop: ArrayLoop) -> FoundStep:
    checks = (
        Check("acc residual", "m/s²", step.before.acceleration,
              step.after.acceleration, 3),
        Check("gyro residual", "deg/s", step.before.rate, step.after.rate),
    )  # fmt: skip
    return FoundStep(
        effect=step.effect,
        p=step.p,
        draws=step.draws,
        evidence=step.evidence,
        checks=checks,
        aliases=step.aliases,
        parameters=tuple(
            p for t in loop.final.found if t.name == step.effect for p in _parameters(loop, t)
        ),
        size=step.value,
        held_out=step.held_out,
        curve=step.effect.removeprefix(CURVE) if step.curve else "",
    )


def _parameters(loop: ArrayLoop, term: Term) -> Iterator[StoredParameter]:
    state = loop.final
    for p, value, sd in zip(
        term.parameters(state.setup.imus), term.theta, state.sd_of(term), strict=True
    ):
        yield StoredParameter(p.name, term.name, "sensor", float(value), float(sd), p.unit)


def _untestable(name: str, impact: float) -> Untestable:
    parameter = array_catalogue()[name].each[0]
    return Untestable(name, f"{parameter.typical:g} {parameter.unit}", 1e3 * impact, "mm rms")


def array_errors(
    loop: ArrayLoop | None, noise: tuple[float, float], imus: int
) -> tuple[ErrorSummary, ...]:
    """Residuals of the accelerometers (m/s²), which are the principal ones, and the gyros (deg/s).

    noise : m/s² and rad/s, of a sample at rest, which sets the floor: of the 3 K numbers of a
    sample the motion takes 6 from the accelerometers (dω/dt and s) and 3 from the gyros (ω)
    """
    floors = (
        noise[0] / _NORMAL_MAD * np.sqrt(1.0 - 2.0 / imus),
        noise[1] / DEG / _NORMAL_MAD * np.sqrt(1.0 - 1.0 / imus),
    )
    held = ((_NAN, _NAN), (_NAN, _NAN))
    if loop is not None:
        before, after = loop.before, loop.after
        held = (before.acceleration, after.acceleration), (before.rate, after.rate)
    return tuple(
        ErrorSummary(
            metric=f"{sensor} residual in motion, MAD",
            unit=unit,
            raw=_NAN,
            base=_NAN,
            final=_NAN,
            floor=float(floor),
            held_out=HeldOutError(_NAN, *two),
        )
        for sensor, unit, floor, two in zip(
            ("accelerometer", "gyro"), ("m/s²", "deg/s"), floors, held, strict=True
        )
    )


def _noise_words(noise: SensorNoise, unit: float, name: str) -> str:
    """The distribution in words."""
    words = f"{noise.sigma / unit:.3g} {name}"
    if noise.growth > 0.0:
        words += f" times sqrt(1 + (|ω| / {1.0 / noise.growth / DEG:.0f} deg/s)²)"
    if np.isfinite(noise.freedom):
        words += f", Student t of {noise.freedom:g} degrees of freedom"
    if noise.gained > 0.0:
        words += f"; held-out halves gain {noise.gained:.0f} nats by that shape"
    return words


def noise_block(loop: ArrayLoop) -> dict[str, Any]:
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
    block["beats_hz"] = [] if loop.ages is None else loop.ages.clock.frequency
    return block


def effect_blocks(loop: ArrayLoop) -> list[dict[str, Any]]:
    """Accepted effects with values and standard deviations, for the YAML and report.json."""
    return [
        {
            **_beats(loop, term),
            "effect": term.name,
            "declared": term.name in loop.asked.declare,
            "sensor": term.effect.sensor,
            "equation": term.effect.equation,
            "parameters": [
                {"name": p.name, "unit": p.unit, "value": p.value, "sd": p.sd}
                for p in _parameters(loop, term)
            ],
        }
        for term in loop.final.found
    ]


def _beats(loop: ArrayLoop, term: Term) -> dict[str, Any]:
    """Clocks of the gyros in this recording: they start anew with the power."""
    if not term.effect.needs_age or loop.ages is None:
        return {}
    setup = loop.final.setup
    return {
        "beats": [
            None if beat is None else {
                "imu": imu, "hz": beat.frequency, "phase_turns": beat.phase, "at_s": beat.at,
                "wander_turns": beat.wander,
            }
            for imu, beat in zip(setup.imus, beats(loop.ages, setup.t), strict=True)
        ]
    }  # fmt: skip


@dataclass(frozen=True)
class LinearPart:
    """What found effects add to a calibrated reading, to first order about rest.

    gain, offset : (K, 3, 3) and (K, 3) of the accelerometers, m/s²: reading = gain force + offset
    gyro_gain, gyro_offset : the same of the gyros, rad/s
    left : effects of which more remains, and its rms in this motion, with the unit
    """

    gain: Array
    offset: Array
    gyro_gain: Array
    gyro_offset: Array
    left: tuple[tuple[str, float, str], ...]


def linear_part(loop: ArrayLoop) -> LinearPart:
    """The linear part of all found effects, in the middle of the motion."""
    state = loop.final
    k = state.setup.triads
    gains, offsets, left = {}, {}, []
    for sensor in ("accelerometer", "gyroscope"):
        gains[sensor] = np.tile(np.eye(3), (k, 1, 1))
        offsets[sensor] = np.zeros((k, 3))
    for term in state.found:
        gyro = term.effect.sensor == "gyroscope"
        gain, offset = _slope(loop, term, gyro=gyro)
        gains[term.effect.sensor] += gain
        offsets[term.effect.sensor] += offset
        motion = state.motion
        drive = np.broadcast_to(motion.rate[:, None], motion.force.shape) if gyro else motion.force
        whole = term.reading(term.columns(motion))
        beyond = whole - np.einsum("kij,tkj->tki", gain, drive) - offset
        rms, of = (float(np.sqrt(np.mean(v**2))) for v in (beyond, whole))
        if rms > _SMALL * of:
            left.append((term.name, rms / DEG if gyro else rms, "deg/s" if gyro else "m/s²"))
    return LinearPart(gains["accelerometer"], offsets["accelerometer"], gains["gyroscope"],
                      offsets["gyroscope"], tuple(left))  # fmt: skip


def _slope(loop: ArrayLoop, term: Term, *, gyro: bool) -> tuple[Array, Array]:
    """(K, 3, 3) and (K, 3): what a term adds per unit of force or rate, and at rest."""
    state, h = loop.final, 1e-4
    k = state.setup.triads
    small = np.zeros((4, 3))
    small[1:] = h * np.eye(3)
    zero, still = np.zeros((4, k, 3)), np.zeros((4, 3))
    force = zero if gyro else np.broadcast_to(small[:, None], (4, k, 3)).copy()
    at = ArrayMotion(
        state.setup.imus, np.full(4, float(np.median(state.setup.t))), np.full(4, 0.5),
        small if gyro else still, still, force, zero, state.setup.rotations, np.zeros((4, k)),
    )  # fmt: skip
    made = term.reading(term.columns(at))
    return np.asarray((made[1:] - made[:1]).transpose(1, 2, 0) / h), np.asarray(made[0])
