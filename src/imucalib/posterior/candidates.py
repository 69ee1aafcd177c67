"""What a search tries: effects and scans of the catalogue, and what each does to a fit."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import MOTION, Context, Effect, EffectScan, Truth
from imucalib.core.fit import Fit
from imucalib.core.model import Model, Prediction
from imucalib.effects import catalogue, families, named


@dataclass(frozen=True)
class SearchedEffects:
    """Effects by name, and scans over a value."""

    effects: Mapping[str, Effect]
    families: tuple[EffectScan, ...]


def effects_to_search(
    only: tuple[str, ...],
    without: tuple[str, ...],
    own: Mapping[str, Effect],
    usable: Callable[[Effect], bool] = lambda effect: True,
) -> SearchedEffects:
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
    return SearchedEffects(effects, tuple(families()[n] for n in wanted if n in families()))


def _at_rest(effect: Effect) -> bool:
    return effect.channel == "acceleration" and not set(effect.needs) & set(MOTION)


def effect_columns(fit: Fit, effect: Effect) -> Array:
    """(N, m) columns of a catalogue effect at θ = 0, in the balance's units at typical sizes."""
    typical = np.array([p.typical for p in effect.parameters(fit.observations.context)])
    return np.asarray(effect_slopes(fit, effect, predict_by_fit(fit)) * typical)


def effect_slopes(fit: Fit, effect: Effect, prediction: Prediction) -> Array:
    """(N, m) what a catalogue effect does at θ = 0, per unit of each parameter.

    The effect's own derivative at the fitted truth, chained through what acts after it.
    prediction : of the fit: an effect that does nothing at its start needs no new one
    """
    context, reference = fit.observations.context, fit.observations.reference
    start = np.array([p.start for p in effect.parameters(context)])
    if effect.stage == "mounting" or start.any():
        truth = reference.truth(fit.eta)
        return fit.at.columns(slopes_within(fit.model, fit.theta, effect, truth, context))
    if effect.stage == "sensor":
        slope = effect.act(start, Truth(prediction.force), context).d_theta
    else:
        slope = effect.act(start, Truth(prediction.set_up), context).d_theta
        slope = prediction.d_set_up @ slope
    return fit.at.columns(slope)


def slopes_within(
    model: Model, theta: Array, effect: Effect, truth: Array, context: Context
) -> Array:
    """(n, K, 3, p) slopes of an effect at its start in a model at θ that has it."""
    grown = model.plus(effect)
    slices, start = grown.slices(context), grown.start(context)
    for name, part in model.slices(context).items():
        start[slices[name]] = theta[part]
    return grown.predict(start, truth, context).d_theta[..., slices[effect.name]]


def testable(fit: Fit, effects: Iterable[Effect]) -> Iterator[Effect]:
    """Effects that the model lacks and the context can carry. By the size of gravity alone a part
    of another effect shows no more than that one."""
    data = fit.observations
    for effect in effects:
        part = effect.part_of and not data.reference.directed
        usable = not part and not effect.missing(data.context)
        if usable and effect.name not in fit.model.names and effect.parameters(data.context):
            yield effect


def predict_by_fit(fit: Fit) -> Prediction:
    """The fitted model's prediction of the fit's own observations."""
    context, reference = fit.observations.context, fit.observations.reference
    return fit.model.predict(fit.theta, reference.truth(fit.eta), context)
