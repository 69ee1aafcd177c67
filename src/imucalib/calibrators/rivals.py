"""A fit's intervals with the doubt between models in them.

What is corrected is the likeliest model's; what another model that would do corrects otherwise, at
attitudes all over the sphere, is part of the interval (Hoeting et al. 1999). It is carried as a
shift of the parameters that does the most of it, and what these cannot express as an uncertainty of
the bias.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.uncertainty import correct_readings, force_slope, predict_readings
from imucalib.core.fit import Fit, NoiseMixture
from imucalib.core.sphere import even_directions
from imucalib.errors import NotConverged
from imucalib.posterior.closed_loop.found import Rival
from imucalib.units import MG

#: Attitudes at which models are compared, and a ridge on the shifts in standard deviations.
_ATTITUDES = 100
_RIDGE = 1e-3


def mix_rivals(fit: Fit, rivals: Sequence[Rival], gravity: float) -> Fit:
    """The fit with its covariance and its intervals widened by what the rivals correct otherwise.

    rivals : likeliest first, `fit` the first with its names; gravity : m/s²
    """
    names = set(fit.model.names)
    own = next((r for r in rivals if set(r.fit.model.names) == names), None)
    others = [r for r in rivals if r is not own]
    if not others or own is None:
        return fit
    force = gravity * even_directions(_ATTITUDES)
    slope = force_slope(fit, force)[0].reshape(3 * _ATTITUDES, -1)
    try:
        reading = predict_readings(own.fit, force)
        plain = correct_readings(own.fit, reading)
    except NotConverged:  # its inverse ends where the recording did
        return fit
    mixture = fit.mixture or NoiseMixture(
        np.zeros(1), np.ones(1), np.zeros((1, fit.theta.size)), fit.covariance[None]
    )
    weight, shift, spread = [own.weight * mixture.weight], [mixture.shift], [mixture.covariance]
    more = np.zeros_like(fit.covariance)
    for rival in others:
        try:
            away = (correct_readings(rival.fit, reading) - plain).reshape(-1)
        except NotConverged:
            continue
        moved, rest = _shift(fit, slope, away)
        weight.append(np.array([rival.weight]))
        shift.append(moved[None])
        # Of a model that is one of many, what noise does is as good as normal.
        spread.append((fit.covariance + rest)[None])
        more += rival.weight * (np.outer(moved, moved) + rest)
    total = np.concatenate(weight)
    whole = NoiseMixture(
        mixture.log_sd, total / total.sum(), np.concatenate(shift), np.concatenate(spread)
    )
    return replace(fit, covariance=fit.covariance + more, mixture=whole)


def _shift(fit: Fit, slope: Array, away: Array) -> tuple[Array, Array]:
    """The shift of θ that moves corrections (m,) as they are away, and the covariance (p, p) of the
    bias that is as large as the rest."""
    size = np.sqrt(np.diag(fit.covariance))
    ridge = _RIDGE * float(np.linalg.norm(slope * size)) * np.eye(size.size)
    scaled = np.vstack([slope * size, ridge])
    shift = (
        size * np.linalg.lstsq(scaled, np.concatenate([away, np.zeros(size.size)]), rcond=None)[0]
    )
    rest = float(np.mean((away - slope @ shift) ** 2)) / MG**2
    covariance = np.zeros((size.size, size.size))
    part = fit.model.slices(fit.observations.context).get("bias")
    if part is not None:
        covariance[part, part] = rest * np.eye(part.stop - part.start)
    return shift, covariance
