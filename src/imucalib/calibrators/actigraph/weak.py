"""Weak coverage: what the postures do not determine stays at its nominal value, and is said so.

Data sheets and practice know each parameter to its typical size. That is the prior of a fit whose
data leave something open: what gravity has shown moves, the rest keeps the prior's uncertainty.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.actigraph.observations import weighted
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.prior import Prior, independent
from imucalib.errors import NotConverged
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.rests.runs import PostureRuns
from imucalib.units import MG

NINE = ("bias", "scale", "non_orthogonality")
#: A combination that is known worse than this share of its typical size is weakly determined: what
#: data sheets say of it then counts for more than a tenth of what is known.
_WEAK = 1.0 / 3.0
#: m/s², runs at rest scatter by no more: what is beyond is something that the model lacks.
_SCATTER = 5.0 * MG
#: With fewer postures a parameter than this, their scatter has a prior too: 1 mg.
_ENOUGH = 3


def base_fit(model: Model, data: Observations, runs: PostureRuns) -> tuple[Fit, int]:
    """Least squares where many postures determine everything, else the maximum a posteriori.

    Returns the fit and how many runs count less.
    """
    parameters = model.parameters(data.context)
    if data.n > _ENOUGH * len(parameters):
        try:
            found, light = robust_fit(model, data, runs)
            if found.converged and not is_weak(found):
                return found, light
        except (NotConverged, np.linalg.LinAlgError):
            pass  # open directions ran away; the prior holds them
    typical = np.array([p.typical for p in parameters])
    return beside(independent(model.start(data.context), typical), model, data, runs)


def beside(prior: Prior, model: Model, data: Observations, runs: PostureRuns) -> tuple[Fit, int]:
    """The maximum a posteriori, and how many runs count less. Many runs tell their scatter
    themselves."""
    many = data.n > _ENOUGH * len(prior.mean)
    prior = replace(prior, noise=None) if many else prior
    found, light = fit_model(model, data, start=prior.mean, prior=prior), 0
    for _ in range(2 * many):
        data, light = weighted(found, runs)
        found = fit_model(model, data, start=found.theta, prior=prior)
    return found, light


def robust_fit(model: Model, data: Observations, runs: PostureRuns) -> tuple[Fit, int]:
    """Fit with the scatter between runs and the weight of strange ones as the data show them."""
    found, light = fit_model(model, data), 0
    for _ in range(2):
        if found.null_directions:
            break
        data, light = weighted(found, runs)
        found = fit_model(model, data, start=found.theta)
    return found, light


def is_weak(fit: Fit) -> bool:
    """Whether some combination of the nine parameters is not well known from the postures."""
    if fit.prior is None and fit.null_directions:
        return True
    slices = fit.model.slices(fit.observations.context)
    own = np.concatenate([np.arange(slices[n].start, slices[n].stop) for n in NINE])
    some = np.zeros((own.size, len(fit.theta)))
    some[np.arange(own.size), own] = [1.0 / fit.parameters[k].typical for k in own]
    return known_worse(fit, some * _as_noise(fit))


def _as_noise(fit: Fit) -> float:
    """Share of the scatter of many runs that may be noise: postures are not few because something
    else is missing, which only a search can tell."""
    if fit.prior is not None or fit.observations.n <= _ENOUGH * len(fit.theta):
        return 1.0
    return min(1.0, _SCATTER / float(np.median(fit.at.sigma)))


def known_worse(fit: Fit, root: Array) -> bool:
    """Whether some combination is known worse than a third of what is known beforehand.

    root : (q, p), rootᵀ root the precision of that
    """
    return bool(np.linalg.eigvalsh(root @ fit.covariance @ root.T)[-1] > _WEAK**2)


def from_data(fit: Fit) -> Array:
    """(p,) share of what is known of a parameter that the data have shown: 1 - (sd / sd before)².

    0: as uncertain as before the recording, by the prior or by its typical size; 1: known from the
    recording alone.
    """
    before = np.array([p.typical for p in fit.parameters])
    if fit.prior is not None:
        before = np.sqrt(np.diag(fit.prior.covariance))
    return np.asarray(np.clip(1.0 - (fit.sd / before) ** 2, 0.0, 1.0))


def open_words(fit: Fit) -> str:
    """The parameters of which the data have shown less than nine tenths, with that share."""
    share = from_data(fit)
    order = [k for k in np.argsort(share) if share[k] < 0.9]
    if not order:
        return "some combinations of parameters"
    return ", ".join(f"{fit.parameters[k].name} ({100.0 * share[k]:.0f} %)" for k in order)
