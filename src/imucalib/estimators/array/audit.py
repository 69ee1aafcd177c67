"""Checks of Laplace's method in the array likelihood: quadrature, and unbiased importance draws."""

from __future__ import annotations

from itertools import product

import numpy as np

from imucalib.arrays import Array
from imucalib.estimators.array.likelihood import ArrayPosterior, conditionals
from imucalib.estimators.array.rates import cholesky_last, modes
from imucalib.estimators.array.rotation import local


def quadrature_gain(posterior: ArrayPosterior, x: Array, order: int = 5) -> Array:
    """(B,) log likelihood by Gauss-Hermite quadrature of order³ nodes a sample, less Laplace's.

    What matters is how this varies over the posterior, not its level.
    """
    nodes, weights = np.polynomial.hermite_e.hermegauss(order)
    points = np.array(list(product(nodes, repeat=3)))
    mass = np.prod(list(product(weights / np.sqrt(2.0 * np.pi), repeat=3)), axis=1)
    return np.array([_gain(posterior, one[None], points, np.log(mass)) for one in x])


def importance_gain(
    posterior: ArrayPosterior, x: Array, draws: int, rng: np.random.Generator
) -> Array:
    """(B,) the same by `draws` importance draws from each conditional Laplace Gaussian.

    The likelihood with this added is unbiased, so a Metropolis step on it is exact; its variance
    says what exactness would cost.
    """
    shape = (draws, posterior.data.samples, 3)
    even = np.full(draws, -np.log(draws))
    return np.array([_gain(posterior, one[None], rng.standard_normal(shape), even) for one in x])


def _gain(posterior: ArrayPosterior, x: Array, points: Array, log_mass: Array) -> float:
    """Σ over the samples of log Σ mass exp(-f(ω) + f(mode) + |u|²/2), ω = mode + root u.

    points : (n, 3), the same for all samples, or (n, T, 3)
    """
    from scipy.special import logsumexp

    given, _ = conditionals(posterior.data, posterior.prior, x)
    mode = modes(given, posterior.start)
    w, here = mode.rate, mode.here
    root = cholesky_last(mode.covariance)
    u = points if points.ndim == 3 else np.repeat(points[:, None], w.shape[-1], axis=1)
    spread = np.einsum("ijt,ntj->nit", root[0], u)
    value = local(given, w + spread, curvature=False).value
    log_ratio = here.value - value + 0.5 * np.sum(u * u, axis=-1)
    return float(np.sum(logsumexp(log_ratio + log_mass[:, None], axis=0)))
