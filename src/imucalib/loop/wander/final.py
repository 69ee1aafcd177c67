"""A model fitted under a noise with a walk, and its parameters' covariance with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core import balance as balancing
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.estimators.least_squares import evaluate
from imucalib.loop.wander.noise import Noise, walk_columns
from imucalib.loop.wander.walk import whitened
from imucalib.units import MG

#: Steps at most, and in standard deviations one after which the next is a hundred times smaller.
_STEPS, _SETTLED = 12, 0.01


def fitted(model: Model, data: Observations, noise: Noise, start: Array, precision: Array) -> Fit:
    """Generalised least squares, Gauss-Newton, with normal priors about zero.

    start : (p,) θ; precision : (p,) of the priors, in typical sizes
    """
    own = np.broadcast_to(MG * noise.sigma[:, None, None], data.sigma.shape).copy()
    data = replace(data, sigma=own)
    typical = np.array([p.typical for p in model.parameters(data.context)])
    theta, settled = start, False
    for _ in range(_STEPS):
        residual, jacobian = _white(model, data, noise, theta)
        information = jacobian.T @ jacobian + np.diag(precision / typical**2)
        pull = jacobian.T @ residual - precision / typical**2 * theta
        covariance = np.asarray(np.linalg.inv(information), np.float64)
        step = covariance @ pull
        theta = theta + step
        settled = bool(np.all(step**2 <= _SETTLED**2 * np.diag(covariance)))
        if settled:
            break
    eta = data.reference.start(model.correct(theta, data.reading, data.context))
    found = evaluate(model, data, theta, covariance, balancing.Noise(1.0), eta)
    return replace(found, noise=balancing.Noise(1.0), converged=settled)


def _white(model: Model, data: Observations, noise: Noise, theta: Array) -> tuple[Array, Array]:
    """Residual (n,) and jacobian (n, p) in units of the noise, at the directions that fit best."""
    eta = data.reference.start(model.correct(theta, data.reading, data.context))
    at = balancing.balance(model, theta, eta, data)
    unit = data.sigma[:, 0, 0] / MG / noise.scatter
    columns = np.column_stack([at.residual, at.jacobian]) * unit[:, None]
    course = replace(noise.course, seen=walk_columns(at, data.reading))
    white, _ = whitened(course, (noise.walk,), columns)
    return white[0, :, 0], white[0, :, 1:]
