"""What neighbouring samples share of their noise: how many of them count as one."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.loop.found import Unexplained
from imucalib.loop.posterior.odds import COMPLETE

#: Samples over which a sum of residuals is taken, and the farthest neighbours that are asked.
_RUN, _FAR = 16, 6
#: Pairs of neighbours below which nothing is known of what they share, and standard deviations of
#: chance below which it is nothing.
_FEWEST, _CHANCE = 50, 2.0


def _shared(state: ArrayState, *, gyro: bool) -> Iterator[tuple[float, float]]:
    """Correlation of the weighted residuals of samples 1, 2, ... apart, and how many independent
    products it is the mean of; until there are few."""
    setup, off = state.setup, state.sampled.off
    values = off.rate if gyro else off.acceleration
    weight = state.sampled.weights.rate if gyro else state.sampled.weights.acceleration
    white = (values * np.sqrt(weight)[..., None])[setup.inner]
    beside = np.diff(setup.rows[setup.inner]) == 1
    power = float(np.mean(white**2))
    # The motion takes its share of the numbers out of every sample.
    numbers = max(3 * white.shape[1] - (3 if gyro else 6), 1)
    for k in range(1, _FAR + 1):
        together = np.convolve(beside, np.ones(k), "valid") == k
        if together.sum() < _FEWEST or power == 0.0:
            return
        product = float(np.mean((white[:-k] * white[k:])[together]))
        yield product / power, float(together.sum() * numbers)


def shared_by_neighbours(state: ArrayState, *, gyro: bool) -> float:
    """How many times fewer samples noise with memory is worth: the variance of a sum over a run
    of samples over that of independent ones, 1 + 2 Σ ρ_k (1 - k / run), up to the first neighbour
    that shares nothing beyond chance."""
    factor = 1.0
    for k, (rho, n) in enumerate(_shared(state, gyro=gyro), 1):
        if rho * np.sqrt(n) < _CHANCE:
            break
        factor += 2.0 * rho * (1.0 - k / _RUN)
    return factor


def remembered(state: ArrayState) -> Iterator[Unexplained]:
    """Sensors whose noise follows its own past, where noise without memory is unlikely at even odds
    (Schwarz 1978): something goes on from sample to sample that the model does not have."""
    for sensor, gyro in (("accelerometer", False), ("gyroscope", True)):
        rho, n = next(_shared(state, gyro=gyro), (0.0, 1.0))
        nats = 0.5 * n * max(rho, 0.0) ** 2 - 0.5 * float(np.log(n))
        p = 1.0 / (1.0 + float(np.exp(min(nats, 700.0))))
        if p < COMPLETE:
            name = f"{sensor} noise correlated in time"
            yield Unexplained(name, "time", "noise", p, nats, 0.0)
