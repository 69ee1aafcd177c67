"""A component of the noise beside a fit: its size estimated, and the fit made again with it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imucalib.core.balance import Noise, balance
from imucalib.core.fit import Fit
from imucalib.core.observations import Observations
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.estimators.variance import NoiseEstimate, estimate_noise


def estimated(fit: Fit, data: Observations, starts: Sequence[tuple[float, float]]) -> NoiseEstimate:
    """The noise beside a fit under data with more components behind its own, the likeliest of a few
    starts: the share of the fitted noise that stays, and each new sd in units of a reading's."""
    at = balance(fit.model, fit.theta, fit.eta, data)
    noise, unit = fit.noise, fit.noise.factor * float(np.median(at.sigma))
    more = len(at.component) - len(noise.sd)
    found = []
    for part, size in starts:
        sd = (*(part * sd for sd in noise.sd), *(size * unit,) * more)
        start = Noise(part * noise.factor, at.component, sd)
        found.append(estimate_noise(at, start, fixed=False))
    return max(found, key=lambda one: one.log_likelihood)


def refitted(fit: Fit, data: Observations, begin: Noise | None = None) -> Fit:
    """The model fitted to data with other components, or the fit as it is where that fails."""
    found = fit_model(fit.model, data, start=fit.theta, begin=begin)
    return found if found.converged else fit
