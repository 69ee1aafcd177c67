"""What the sampler gets once the loop has settled, and what the loop leaves open in its answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.loop.closed_loop import MotionLoop
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.estimators.array.problem import ArrayData
from imucalib.estimators.array.sampler import ArrayPositions


def corrected_samples(state: ArrayState) -> ArrayData:
    """Readings with the effects taken out, as Gaussian data of one sigma.

    Where the noise has tails or grows with the rate, each residual is shrunk to λ/λ₀ of itself: the
    score of every unknown is then the weighted one at the mode, and the precision λ₀ is the mean of
    the weights over what each sample says of the positions (Huber's pseudo-values).
    """
    sampled, inner = state.sampled, state.setup.inner
    lever = np.sum(sampled.turn[inner] ** 2, axis=(1, 2))[:, None]
    weight = sampled.weights.acceleration[inner]
    one = float(np.sum(lever * weight) / np.sum(lever) / weight.shape[1])
    off = sampled.off.acceleration[inner] * (weight / one)[..., None]
    acceleration = sampled.force[inner] + off
    weight = sampled.weights.rate[inner]
    own = float(np.mean(weight))
    off = sampled.off.rate[inner] * (weight / own)[..., None]
    rate = sampled.rate[inner] + off.mean(axis=1)
    k = state.setup.triads
    return ArrayData(acceleration, np.full(k, one**-0.5), rate, np.eye(3) * own * k)


def joint_covariance(loop: MotionLoop) -> Array:
    """(3 (K - 1), 3 (K - 1)) m² of the positions, effects and rests being uncertain too, and the
    noise that neighbours share counted once."""
    state = loop.final
    return state.covariance[: state.positions, : state.positions] * loop.dispersion


def widened(found: ArrayPositions, loop: MotionLoop, rng: np.random.Generator) -> ArrayPositions:
    """Draws with the part of the joint uncertainty added that the sampler did not see."""
    n = found.prior.positions
    missing = joint_covariance(loop) - found.covariance
    values, vectors = np.linalg.eigh(missing)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    shape = found.unknowns.shape[:2]
    unknowns = found.unknowns.copy()
    unknowns[..., :n] += rng.standard_normal((*shape, n)) @ root.T
    return replace(found, unknowns=unknowns)
