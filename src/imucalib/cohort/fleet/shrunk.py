"""A device's calibration with an effect of its fleet: its own data and what the others say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Effect
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.prior import Prior
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.loop.held_out import Held, by_folds, errors, folds_of


def with_priors(fit: Fit, said: Mapping[str, Prior], effects: Mapping[str, Effect]) -> Fit:
    """The fit with effects of whose sizes others say something: θ and covariance of both together.

    said : effect -> its sizes, in typical sizes
    """
    if not said:
        return fit
    return _combined(_extended(fit, _model(fit, said, effects)), said)


def held_out(
    fit: Fit, said: Mapping[str, Prior], effects: Mapping[str, Effect]
) -> tuple[Held, Held]:
    """Errors on each fold of the design, predicted by the rest, without and with the effects."""
    folds = folds_of(fit.observations)
    before = by_folds(fit, folds)
    if not said:
        return before, before
    model = _model(fit, said, effects)
    parts = []
    for fold in folds:
        rest = fit.observations.take(fold.rest)
        start = _start(fit, model)
        own = fit_model(model, rest, start=start, noise=fit.noise)
        parts.append(errors(own, _combined(own, said).theta, fit.observations.take(fold.rows)))
    order = np.argsort(np.concatenate([fold.rows for fold in folds]))

    def each(name: str) -> Array:
        return np.asarray(np.concatenate([getattr(part, name) for part in parts])[order])

    return before, Held(each("corrected"), each("expected"), each("error"))


def _model(fit: Fit, said: Mapping[str, Prior], effects: Mapping[str, Effect]) -> Model:
    return Model((*fit.model.effects, *(effects[name] for name in said)))


def _extended(fit: Fit, model: Model) -> Fit:
    return fit_model(model, fit.observations, start=_start(fit, model), begin=fit.noise)


def _start(fit: Fit, model: Model) -> Array:
    context = fit.observations.context
    start, slices = model.start(context), model.slices(context)
    for name, part in fit.model.slices(context).items():
        start[slices[name]] = fit.theta[part]
    return start


def _combined(fit: Fit, said: Mapping[str, Prior]) -> Fit:
    """Normal prior times normal likelihood, in typical sizes so that rounding stays small."""
    context = fit.observations.context
    typical = np.array([p.typical for p in fit.parameters])
    slices = fit.model.slices(context)
    precision = np.linalg.pinv(fit.covariance / np.outer(typical, typical), hermitian=True)
    whole, towards = precision.copy(), precision @ (fit.theta / typical)
    for name, prior in said.items():
        part, own = slices[name], prior.root.T @ prior.root
        whole[part, part] += own
        towards[part] += own @ prior.mean
    covariance = np.linalg.inv(whole)
    theta = covariance @ towards * typical
    return replace(
        fit, theta=theta, covariance=covariance * np.outer(typical, typical),
        slope=np.zeros_like(fit.slope),
    )  # fmt: skip
