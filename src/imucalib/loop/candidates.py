"""What could be missing: catalogue effects, smooth probes, correlated noise and single records."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.core.context import MOTION
from imucalib.core.effect import Effect, Family
from imucalib.core.fit import Fit
from imucalib.core.model import Prediction
from imucalib.core.truth import Truth
from imucalib.effects import catalogue, families, named


@dataclass(frozen=True)
class Searched:
    """Effects by name, and scans over a value."""

    effects: Mapping[str, Effect]
    families: tuple[Family, ...]


def searched(
    only: tuple[str, ...],
    without: tuple[str, ...],
    own: Mapping[str, Effect],
    usable: Callable[[Effect], bool] = lambda effect: True,
) -> Searched:
    """The effects of sensors at rest that a search tries.

    only : names that it tries alone, or none; without : names that it leaves out; own : effects of
    the user's file; usable : whether a calibrator's reference can show an effect at all

    Raises UsageError for a name that is no effect and no scan.
    """
    every: dict[str, Effect] = {**catalogue(), **own}
    for name in (*only, *without):
        if name not in every and name not in families():
            named(name)
    wanted = [n for n in dict.fromkeys(only or (*every, *families())) if n not in without]
    effects = {
        n: every[n] for n in wanted if n in every and _at_rest(every[n]) and usable(every[n])
    }
    return Searched(effects, tuple(families()[n] for n in wanted if n in families()))


def _at_rest(effect: Effect) -> bool:
    return effect.channel == "acceleration" and not set(effect.needs) & set(MOTION)


#: Name of an error that all triads of one rigid body share.
ALL_TRIADS = "all"


@dataclass(frozen=True)
class Candidate:
    """An effect of the catalogue; columns : (N, m) in the balance's units, at typical sizes."""

    name: str
    columns: Array


def effect_columns(fit: Fit, effect: Effect, prediction: Prediction | None = None) -> Array:
    """(N, m) columns of a catalogue effect at θ = 0, scaled by its typical sizes."""
    typical = np.array([p.typical for p in effect.parameters(fit.observations.context)])
    return np.asarray(effect_slopes(fit, effect, prediction) * typical)


def effect_slopes(fit: Fit, effect: Effect, prediction: Prediction | None = None) -> Array:
    """(N, m) what a catalogue effect does at θ = 0, per unit of each parameter.

    The effect's own derivative at the fitted truth, chained through what acts after it.
    prediction : of the fit, when it is there: an effect that does nothing at its start needs no new
        one
    """
    context = fit.observations.context
    start = np.array([p.start for p in effect.parameters(context)])
    if effect.stage == "mounting" or start.any():
        return fit.at.columns(_beside(fit, effect))
    prediction = prediction or fitted_prediction(fit)
    if effect.stage == "sensor":
        slope = effect.act(start, Truth(prediction.force), context).d_theta
    else:
        slope = effect.act(start, Truth(prediction.set_up), context).d_theta
        slope = prediction.d_set_up @ slope
    return fit.at.columns(slope)


def _beside(fit: Fit, effect: Effect) -> Array:
    """(n, K, 3, p) slopes of an effect at its start in the model that has it."""
    extended = fit.model.plus(effect)
    context, reference = fit.observations.context, fit.observations.reference
    slices = extended.slices(context)
    theta = extended.start(context)
    for name, part in fit.model.slices(context).items():
        theta[slices[name]] = fit.theta[part]
    prediction = extended.predict(theta, reference.truth(fit.eta), context)
    return prediction.d_theta[..., slices[effect.name]]


def effect_candidates(
    fit: Fit, effects: Iterable[Effect]
) -> tuple[tuple[Candidate, ...], dict[str, str]]:
    """Candidates of all effects that the context can carry, and why the others cannot be tested."""
    found, missing = [], {}
    prediction = fitted_prediction(fit)
    for effect in effects:
        if effect.name in fit.model.names:
            continue
        reason = effect.missing(fit.observations.context)
        if effect.part_of and not fit.observations.reference.directed:
            reason = f"by the size of gravity alone it is a part of {effect.part_of}"
        if reason or not effect.parameters(fit.observations.context):
            missing[effect.name] = reason or "it has no parameter on these data"
            continue
        columns = effect_columns(fit, effect, prediction)
        found.append(Candidate(effect.name, columns))
    return tuple(found), missing


def fitted_prediction(fit: Fit) -> Prediction:
    """The fitted model's prediction of the fit's own observations."""
    context, reference = fit.observations.context, fit.observations.reference
    return fit.model.predict(fit.theta, reference.truth(fit.eta), context)
