"""Found effects as calibration.yaml and report.json have them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import stored_parameters
from imucalib.calibration.triads import triangle
from imucalib.calibrators.array.board.rests import BASE, RestFit
from imucalib.calibrators.array.motion.ages import beats
from imucalib.calibrators.array.motion.closed_loop import MotionLoop
from imucalib.calibrators.array.motion.terms import Term
from imucalib.core.effect import Effect
from imucalib.core.fit import StoredParameter
from imucalib.effects.record_error import is_record_error
from imucalib.posterior.closed_loop.found import CheckedError, FitLoop, Step
from imucalib.units import MG

#: How a name begins that speaks of the rests alone.
AT_REST = "at rest: "


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
        own, declared = list(parameters_of(loop, term)), term.name in loop.scope.declare
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
        term.parameters(state.setup.imus), term.theta, state.sd_of(term), strict=True
    ):
        yield StoredParameter(p.name, term.name, "sensor", float(value), float(sd), p.unit)


def _beats(loop: MotionLoop, term: Term) -> dict[str, Any]:
    """Clocks of the gyros in this recording: they start anew with the power."""
    setup, clock = loop.final.setup, loop.final.clock
    if not term.aged or clock is None:
        return {}
    return {
        "beats": [
            None
            if beat is None
            else {
                "imu": imu,
                "hz": beat.frequency,
                "phase_turns": beat.phase,
                "at_s": beat.at,
                "wander_turns": beat.scatter,
            }
            for imu, beat in zip(setup.imus, beats(clock, setup.t, setup.rows), strict=True)
        ]
    }


def join_rests(loop: MotionLoop, rests: FitLoop | None) -> MotionLoop:
    """The loop over the motion with the records, steps and doubts of the rests before its own."""
    if rests is None:
        return loop
    return replace(
        loop,
        rests=rests,
        records=rests.records,
        steps=(*_rest_steps(rests), *loop.steps),
        rejected=(*((AT_REST + name, why) for name, why in rests.rejected), *loop.rejected),
        unexplained=(
            *loop.unexplained,
            *(replace(u, name=AT_REST + u.name) for u in rests.unexplained),
        ),
    )


def _rest_steps(loop: FitLoop) -> Iterator[Step]:
    """The steps at rest, with their sizes in words."""
    fit = loop.final
    slices = fit.model.slices(fit.observations.context)
    for step in loop.steps:
        part = slices[step.effect]
        rms = float(np.sqrt(np.mean(fit.theta[part] ** 2)))
        unit, count = fit.parameters[part.start].unit, part.stop - part.start
        yield replace(
            step,
            effect=AT_REST + step.effect,
            size=f"{rms:.2g} {unit} rms of {count}",
            formula="",  # each chip has numbers of its own
            checks=tuple(
                CheckedError("rests, leave one out", "m/s²", MG * c.before, MG * c.after, 5)
                for c in step.checks
            ),
            in_its_place=tuple(
                replace(one, effect=AT_REST + one.effect) if one.effect == step.effect else one
                for one in step.in_its_place
            ),
        )
