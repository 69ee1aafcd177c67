"""What neighbouring samples share of their noise: how many of them count as one."""

from __future__ import annotations

import numpy as np

from imucalib.calibrators.array.loop.state import ArrayState

#: Samples over which a sum of residuals is taken, and the farthest neighbours that are asked.
RUN, _FAR = 16, 6
#: Pairs of neighbours below which nothing is known of what they share.
_FEWEST = 50


def shared_by_neighbours(state: ArrayState, *, gyro: bool) -> float:
    """How many times fewer samples noise with memory is worth: the variance of a sum over a run
    of samples over that of independent ones, 1 + 2 Σ ρ_k (1 - k / run), up to the first neighbour
    that shares nothing beyond chance."""
    setup, off = state.setup, state.sampled.off
    values = off.rate if gyro else off.acceleration
    weight = state.sampled.weights.rate if gyro else state.sampled.weights.acceleration
    white = (values * np.sqrt(weight)[..., None])[setup.inner]
    beside = np.diff(setup.rows[setup.inner]) == 1
    power, factor = float(np.mean(white**2)), 1.0
    for k in range(1, _FAR + 1):
        together = np.convolve(beside, np.ones(k), "valid") == k
        if together.sum() < _FEWEST or power == 0.0:
            break
        shared = float(np.mean((white[:-k] * white[k:])[together])) / power
        # The motion takes its share of the numbers out of every sample.
        numbers = together.sum() * max(3 * white.shape[1] - (3 if gyro else 6), 1)
        if shared * np.sqrt(numbers) < 2.0:
            break
        factor += 2.0 * shared * (1.0 - k / RUN)
    return factor
