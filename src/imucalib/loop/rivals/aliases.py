"""Effects that would do as well as a named one, and what has no name and would."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from imucalib.core.context import Context
from imucalib.core.effect import Effect, Response
from imucalib.core.fit import Fit
from imucalib.effects import across, known
from imucalib.effects.thermal.lag import PREFIX, covariate
from imucalib.loop.candidates import effect_candidates
from imucalib.loop.evidence import Candidate, Score, apart
from imucalib.loop.found import LoopSettings, Step
from imucalib.loop.noise.shared import (
    WANDERING,
    WANDERING_SCALE,
    imitated_by_a_scale,
    lead_over_a_walk,
)
from imucalib.loop.rivals.courses import course_of, courses_without_a_cause, driver_of
from imucalib.loop.rivals.swings import beats, number, swings_in_step
from imucalib.loop.search import effect_named, thinned
from imucalib.loop.thresholds import APART, CURVE_TERMS, MARGIN

#: What stands beside a name of a size that no data sheet tells: another effect, of nobody's list.
UNLISTED = "unlisted_effect"
_SURE = 2.0  # standard errors


def aliases(
    current: Fit,
    effects: Mapping[str, Effect],
    chosen: Score,
    scores: tuple[Score, ...],
    rules: LoopSettings,
) -> tuple[str, ...]:
    """Effects that would do as well: nearly the same evidence, or too small an angle between; and a
    curve of another driver with nearly the same evidence, though it pays for its many numbers."""
    near = max(chosen.evidence - 3.0, chosen.evidence / 2.0)
    thin = thinned(current, rules.most_scored)

    def columns(name: str) -> Candidate:
        return effect_candidates(thin, [effect_named(effects, name)])[0][0]

    def beside(rival: Score) -> bool:
        own = rival.candidate.family and rival.candidate.family == chosen.candidate.family
        if rival.candidate.kind != "effect" or rival.name == chosen.name or own:
            return False
        if rival.evidence >= near:
            return True
        alike = rival.evidence >= chosen.evidence / 2.0
        return alike and apart(thin, columns(chosen.name), columns(rival.name)) < APART

    names = tuple(s.name for s in scores if beside(s))
    return names + _curve_beside(effect_named(effects, chosen.name), chosen, scores)


def _curve_beside(effect: Effect, chosen: Score, scores: tuple[Score, ...]) -> tuple[str, ...]:
    own = {driver_of(name) for name in effect.needs} or {"response"}
    for s in scores:
        what, _, rest = s.candidate.curve.partition(":")
        of = what if what == "response" else driver_of(rest.partition(":")[0])
        if s.candidate.curve and s.evidence >= chosen.evidence - MARGIN and of not in own:
            return (f"curve@{s.candidate.curve}:{CURVE_TERMS[1]}",)
    return ()


def without_a_name(before: Fit, after: Fit, chosen: Score, margin: float) -> tuple[str, ...]:
    """What would do as well and has no name: a bias that wanders slowly, or the scale beside what
    goes with the force, unless the effect leads it by `margin` nats; and whatever else where its
    size is beyond what data sheets tell, where the model holds a form of the same driver that has
    no cause, where a swing keeps step or beats, where a lag is the longest that was tried, or where
    a polynomial has no cause of its own."""
    walk = lead_over_a_walk(before, chosen.evidence) < margin
    effect = known(chosen.name)
    forced = isinstance(effect, Response) and effect.basis_dx is not None
    scaled = forced and imitated_by_a_scale(before, after, chosen.name, margin)
    alike = effect is not None and (
        course_of(effect.needs) in courses_without_a_cause(before.model.names)
        or swings_in_step(before, chosen.name)
        or any(beats(before.observations.context, chosen.name, n) for n in before.model.names)
        or _is_longest(before.observations.context, chosen.name)
        or chosen.name.startswith(across.PREFIX)
    )
    other = alike or beyond_usual(after, chosen.name)
    return (WANDERING,) * walk + (WANDERING_SCALE,) * scaled + (UNLISTED,) * other


def beside(fit: Fit, steps: Iterable[Step], chosen: Score) -> tuple[Step, ...]:
    """Steps as they stand beside a new one: a swing that beats with it comes and goes."""
    context = fit.observations.context
    return tuple(
        replace(s, aliases=(*s.aliases, UNLISTED)) if beats(context, s.effect, chosen.name) else s
        for s in steps
    )


def _is_longest(context: Context, name: str) -> bool:
    """Whether a lag is the longest of those tried: what creeps on for ever looks like it too."""
    lags = [c for c in context.covariates if c.startswith(PREFIX)]
    own = covariate(name.partition("@")[2])
    return own in lags and own == max(lags, key=lambda lag: number(lag.removeprefix(PREFIX)))


def beyond_usual(fit: Fit, name: str) -> bool:
    """Whether an effect of a fit is surely larger than data sheets let one expect."""
    part = fit.model.slices(fit.observations.context).get(name, slice(0))
    sure = np.abs(fit.theta[part]) - _SURE * fit.sd[part]
    usual = np.array([p.usual for p in fit.parameters[part]])
    return bool(np.any(sure > usual))
