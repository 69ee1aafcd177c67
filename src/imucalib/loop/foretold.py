"""How likely a model that knows only the rest makes the rows that were left out.

log p(y_F | y_R) with θ integrated flat is the difference of two restricted likelihoods, of all rows
and of the rest, of the model linearised where the rest has fitted it (Patterson and Thompson 1971):
what the rest says of a setting error that rows share is in it, and so is the doubt about θ. Noise
that neighbours share begins anew: nobody who uses a calibration has its neighbours.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.core.balance import Balanced, Noise, balance, whitener
from imucalib.core.fit import Fit
from imucalib.core.observations import Observations
from imucalib.loop.design import Fold

_STRETCHES = 12
_OPEN = 1e-9  # share of the largest singular value below which a direction is not determined


def foretold(fit: Fit, theta: Array, data: Observations, fold: Fold) -> float:
    """Nats of the fold's rows, given the rest, under a fitted model's noise.

    theta : of the fit's model, as the rest has it; data : all rows
    """
    reference = data.reference
    eta = reference.start(fit.model.correct(theta, data.reading, data.context))
    at = _cut(balance(fit.model, theta, eta, data), fold.rows)
    both = np.concatenate([fold.rows, fold.rest])
    return restricted(_of(at, both), fit.noise) - restricted(_of(at, fold.rest), fit.noise)


def foretold_stretches(fit: Fit) -> Array:
    """(stretches,) nats of each of a few stretches in the order of recording, given all others, at
    the linearisation of the fit."""
    order = np.argsort(fit.observations.context["order"], kind="stable")
    every = []
    for rows in np.array_split(order, min(order.size, _STRETCHES)):
        at = _cut(fit.at, rows)
        rest = _of(at, np.setdiff1d(order, rows))
        every.append(restricted(at, fit.noise) - restricted(rest, fit.noise))
    return np.array(every)


def _cut(at: Balanced, rows: NDArray[np.intp]) -> Balanced:
    """With shared noise that rows and all others have each for themselves."""
    apart = np.isin(at.owner, rows)[:, None]
    shared = (np.hstack([m * apart, m * ~apart]) for m in at.settings[at.free :])
    return replace(at, settings=(*at.settings[: at.free], *shared))


def _of(at: Balanced, rows: NDArray[np.intp]) -> Balanced:
    numbers = np.isin(at.owner, rows)
    settings = tuple(matrix[numbers] for matrix in at.settings)
    return replace(
        at, residual=at.residual[numbers], jacobian=at.jacobian[numbers], settings=settings
    )


def restricted(at: Balanced, noise: Noise) -> float:
    """Restricted log likelihood (nats, up to a constant) at a given noise."""
    white = whitener(at.settings, noise.ratio)
    columns, residual = white(at.jacobian) / noise.factor, white(at.residual) / noise.factor
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    use = size > _OPEN * max(float(size.max(initial=0.0)), 1e-300)
    rest = residual - left[:, use] @ (left[:, use].T @ residual)
    log_det = white.log_det + 2.0 * residual.size * np.log(noise.factor)
    log_det += 2.0 * float(np.log(size[use]).sum())
    return float(-0.5 * (log_det + rest @ rest))
