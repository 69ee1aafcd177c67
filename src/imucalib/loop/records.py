"""Setting wrong records aside, the first part of the closed loop; refits from where a fit is."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imucalib.arrays import Array
from imucalib.core.balance import Noise
from imucalib.core.effect import Effect
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.effects.record_error import record_error
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.loop.candidates import ALL_TRIADS
from imucalib.loop.held_out import theta_without, without_records
from imucalib.loop.record_errors import (
    RecordError,
    diagnose,
    predict_record,
    record_number,
)
from imucalib.units import MG


def set_aside(fit: Fit, row: int) -> Fit:
    """Refit with all numbers of a record free.

    The whole record goes, whichever of its numbers stood out: what is left of it could otherwise
    be fitted by a setting that is as wrong as the number was.
    """
    observations = fit.observations
    triads = observations.reading.shape[1]
    known = fit.at.keep.shape[2] == 3 * triads
    # One number for one: its size is that of gravity, which the axis along gravity shows best.
    along = "xyz"[int(np.argmax(np.abs(observations.reading[row, 0])))]
    axes = "xyz" if known or triads > 1 else along
    effect = record_error(record_number(fit, row), observations.label[row], axes)
    nominal = observations.reference.truth(_settled(fit))
    predicted = fit.model.predict(fit.theta, nominal, observations.context).reading
    off = (observations.reading[row, 0] - predicted[row, 0]) / MG
    return extended(fit, effect, off if known else None)


def foreseen(fit: Fit, aside: Fit) -> bool:
    """Whether the other records tell what one that was set aside should have been. Of several
    triads a rest leaves its attitude open, which no record has to tell."""
    alone = fit.observations.reading.shape[1] == 1
    opened = len(aside.null_directions) > len(fit.null_directions)
    return aside.converged and not (alone and opened)


def _settled(fit: Fit) -> Array:
    """η with the settings as they were meant, for references that have settings."""
    return np.zeros_like(fit.eta) if fit.at.free else fit.eta


def accused(fit: Fit, found: Sequence[tuple[int, float]]) -> tuple[RecordError, ...]:
    """The same of rows and the log odds against each, by the number that is farthest off."""
    return tuple(diagnose(fit, row, _channel(fit, row), math.exp(-o), o) for row, o in found)


def _of_triads(fit: Fit, row: int) -> str:
    """The triad that is farther off the others than these are off gravity's size, or all; of a
    single one the norm."""
    context, reference = fit.observations.context, fit.observations.reference
    if len(context.triads) == 1:
        return "norm"
    rows = np.array([row])
    theta = without_records(fit, theta_without(fit, rows))
    force = fit.model.correct(theta, fit.observations.reading[rows], context.take(rows))
    common = context.in_common(force)[0]
    middle = np.median(common, axis=0)
    away = np.linalg.norm(common - middle, axis=1)
    gravity = float(np.linalg.norm(reference.truth(fit.eta)[row, 0]))
    alone = float(away.max()) > abs(float(np.linalg.norm(middle)) - gravity)
    return context.triads[int(np.argmax(away))] if alone else ALL_TRIADS


def _channel(fit: Fit, row: int) -> str:
    """Which axis of a record is off most."""
    if not fit.observations.reference.directed:
        return _of_triads(fit, row)
    said = predict_record(fit, row)
    away = np.abs(fit.observations.reading[row, 0] - said.mean)
    return "xyz"[int(np.argmax(away / np.sqrt(np.diag(said.covariance))))]


def extended(
    fit: Fit, effect: Effect, start: Array | None = None, noise: Noise | None = None
) -> Fit:
    """Refit with one more effect, from where the fit is; `start` for the effect's parameters,
    `noise` to hold it at."""
    return _refit(fit, fit.model.plus(effect), effect.name, start, noise)


def reduced(fit: Fit, names: tuple[str, ...]) -> Fit:
    """Refit without some effects, from where the fit is."""
    return _refit(fit, Model(tuple(e for e in fit.model.effects if e.name not in names)))


def _refit(
    fit: Fit,
    model: Model,
    fresh: str = "",
    values: Array | None = None,
    noise: Noise | None = None,
) -> Fit:
    context = fit.observations.context
    start, own = model.start(context), model.slices(context)
    for name, part in fit.model.slices(context).items():
        if name in own:
            start[own[name]] = fit.theta[part]
    if values is not None:
        start[own[fresh]] = values
    return fit_model(model, fit.observations, start=start, noise=noise)
