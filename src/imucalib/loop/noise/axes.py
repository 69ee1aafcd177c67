"""Axes that are noisier than the others: a part of the noise, not wrong records or heavy tails.

The excess of an axis is a variance component of its own, one number a reading. It is estimated
first, and again after every effect, as noise that neighbours share is.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.balance import Noise, balance
from imucalib.core.fit import Fit
from imucalib.core.observations import Observations, SharedNoise
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.estimators.variance import NoiseEstimate, estimate_noise
from imucalib.loop.thresholds import AXIS_NATS, AXIS_NUMBERS

_FEWEST = 12  # observations from which the scatter of an axis is worth a number
_NAMES = ("noise of x", "noise of y", "noise of z")
_LIKELY = 1.5  # standard deviations of the score from which an estimate is worth its cost
_SHARE = 0.6  # of the noise of all axes that is left to the others, to start from


def with_noisy_axes(fit: Fit) -> Fit:
    """The same model, refitted with the excess of every axis that is noisier, if one is.

    Up to `AXIS_NUMBERS` numbers of a single triad in known directions: of a size alone no axis is
    seen. What neighbours share is taken out of the model.
    """
    own, sessions = fit.observations, fit.observations.of_sessions
    bare = replace(own, shared=sessions)
    found = fit if len(own.shared) == len(sessions) else _refitted(fit, bare)
    size = fit.at.residual.size
    if size != 3 * own.n or own.n < _FEWEST or size > AXIS_NUMBERS:
        return found
    tried = [_estimated(found, axes) for axes in _likely(found)]
    best = max(tried, key=lambda one: one[1].log_likelihood - AXIS_NATS * one[2], default=None)
    if best is None or best[1].log_likelihood - found.log_likelihood <= AXIS_NATS * best[2]:
        return found
    return _refitted(found, best[0], best[1].noise)


def _likely(fit: Fit) -> list[tuple[int, ...]]:
    """Axes that may be noisier: each that stands out above, and both others of one below."""
    score = _beyond(fit)
    alone: list[tuple[int, ...]] = [(int(axis),) for axis in np.flatnonzero(score > _LIKELY)]
    quiet = int(np.argmin(score))
    others = tuple(axis for axis in range(3) if axis != quiet)
    return [*alone, others] if score[quiet] < -_LIKELY else alone


def _estimated(fit: Fit, axes: tuple[int, ...]) -> tuple[Observations, NoiseEstimate, int]:
    """The noise with the excess of some axes, and of how many."""
    own = fit.observations
    data = replace(own, shared=(*own.shared, *(_excess(fit, axis) for axis in axes)))
    at = balance(fit.model, fit.theta, fit.eta, data)
    size = fit.noise.factor * float(np.median(at.sigma))
    sd = (*(_SHARE * sd for sd in fit.noise.sd), *(size for _ in axes))
    start = Noise(_SHARE * fit.noise.factor, at.component, sd)
    return data, estimate_noise(at, start, fixed=False), len(axes)


def _beyond(fit: Fit) -> Array:
    """(3,) how far the power of each axis lies above what the noise of all explains, in standard
    deviations: the score of its excess at none (Rao 1948)."""
    white, q = fit.white_basis()
    inverse = white(np.eye(fit.at.residual.size))
    outside = inverse - q @ (q.T @ inverse)
    projector = (inverse.T @ outside).reshape(-1, 3, fit.observations.n, 3)
    power = np.square(outside.T @ white(fit.at.residual) / fit.noise.factor).reshape(-1, 3)
    expected = np.einsum("nini->i", projector)
    spread = np.sqrt(2.0 * np.einsum("nimi,nimi->i", projector, projector))
    return np.asarray((power.sum(axis=0) - expected) / spread)


def _excess(fit: Fit, axis: int) -> SharedNoise:
    n = fit.observations.n
    basis = np.zeros((n, 3, 1))
    # In proportion to what is declared of each reading.
    basis[:, axis, 0] = fit.observations.sigma[:, 0, axis] / np.median(fit.observations.sigma)
    return SharedNoise(_NAMES[axis], np.eye(n), math.nan, basis=basis)


def _refitted(fit: Fit, data: Observations, begin: Noise | None = None) -> Fit:
    found = fit_model(fit.model, data, start=fit.theta, begin=begin)
    return found if found.converged else fit
