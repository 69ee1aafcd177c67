"""What the sampler gets of a joint fit, and its draws with all that is uncertain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.calibrators.array.estimate.total import Total
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.estimators.array.problem import ArrayData
from imucalib.estimators.array.sampler import ArrayPositions


def corrected_samples(state: ArrayState) -> ArrayData:
    """Readings with the effects taken out, as Gaussian data of one sigma.

    Where the noise has tails or grows with the rate, each residual is shrunk to λ/λ₀ of itself: the
    score of every unknown is then the weighted one at the mode (Huber's pseudo-values). The
    precision λ₀ is the mean of the weights over what each sample says of the positions, times the
    share of it that noise with tails tells.
    """
    sampled, inner = state.sampled, state.setup.inner
    lever = np.sum(sampled.turn[inner] ** 2, axis=(1, 2))[:, None]
    weight = sampled.weights.acceleration[inner]
    one = float(np.sum(lever * weight) / np.sum(lever) / weight.shape[1])
    one *= state.noise[0].information
    off = sampled.off.acceleration[inner] * (weight / one)[..., None]
    acceleration = sampled.force[inner] + off
    weight = sampled.weights.rate[inner]
    own = float(np.mean(weight)) * state.noise[1].information
    off = sampled.off.rate[inner] * (weight / own)[..., None]
    rate = sampled.rate[inner] + off.mean(axis=1)
    k = state.setup.triads
    return ArrayData(acceleration, np.full(k, one**-0.5), rate, np.eye(3) * own * k)


def restated(found: ArrayPositions, total: Total, rng: np.random.Generator) -> ArrayPositions:
    """The draws carried over to the mean and the covariance of all that is uncertain, of which the
    sampler saw a part."""
    n, d = found.free.shape
    root = np.linalg.cholesky(total.covariance)
    if n > 2 * d:
        away = found.free - found.free.mean(axis=0)
        white = np.linalg.solve(np.linalg.cholesky(found.covariance), away.T)
    else:
        white = rng.standard_normal((d, n))
    moved = total.mean[1:].ravel() + (root @ white).T
    unknowns = found.unknowns.copy()
    unknowns[..., :d] = moved.reshape(*unknowns.shape[:2], d)
    return replace(found, unknowns=unknowns)
