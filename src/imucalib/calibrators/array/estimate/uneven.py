"""Whether positions are the same in all parts of the motion, as a rigid board's are.

Each sample pulls the answer by its score. In a part of the motion these pulls add up by chance, or
by what the part has of its own: a board that bows as it warms up, chips that tilt with the rate.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibrators.array.loop.state import ArrayState

#: What is left where they are not, with what the parts differ by.
POSITIONS = "positions against "
#: Family-wise chance over all coordinates and drives below which positions are not the same.
_ALPHA = 1e-3
#: Parts of a drive other than time, and samples of a part at least.
_PARTS, _FEWEST = 4, 40


@dataclass(frozen=True)
class Uneven:
    """driver : what the parts differ by; p : family-wise; nats : of the coordinate that shows it
    most; spread : (d,) m, sd of each coordinate over the parts, beyond chance"""

    driver: str
    p: float
    nats: float
    spread: Array


def uneven(state: ArrayState, pulls: Array, dispersion: float) -> Uneven | None:
    """By the drive that shows it most; None where chance does as well.

    pulls : (inner, d) m, what each sample moves the positions by; dispersion : how many times fewer
    samples noise that neighbours share leaves
    """
    found = [_by(driver, part, pulls, dispersion) for driver, part in _drives(state)]
    p = min(one.p for one in found) * len(found)
    if p > _ALPHA:
        return None
    worst = min(found, key=lambda one: one.p)
    spread = np.max([one.spread for one in found if one.p * len(found) <= _ALPHA], axis=0)
    return Uneven(worst.driver, p, worst.nats, spread)


def _drives(state: ArrayState) -> Iterator[tuple[str, Index]]:
    """What could change positions, with the part (inner,) that each sample belongs to."""
    inner, sampled = state.setup.inner, state.sampled
    yield "time", state.setup.block
    for name, vector in (("|ω|", sampled.rate), ("|a|", sampled.origin)):
        size = np.linalg.norm(vector[inner], axis=1)
        ends = np.quantile(size, np.arange(1, _PARTS) / _PARTS)
        yield name, np.searchsorted(ends, size).astype(np.intp)


def _by(driver: str, part: Index, pulls: Array, dispersion: float) -> Uneven:
    """Sums of the pulls over parts, of variance Σ u² under chance: χ² of each coordinate, and what
    the parts' own places scatter by beyond it."""
    from scipy.special import gammaincc

    square, beyond, freedom = np.zeros(pulls.shape[1]), np.zeros(pulls.shape[1]), -1
    for one in np.unique(part):
        own = pulls[part == one]
        if len(own) < _FEWEST:
            continue
        total, share = own.sum(axis=0), len(own) / len(pulls)
        chance = dispersion * np.sum(own**2, axis=0)
        square += total**2 / chance
        beyond += (total**2 - chance) / share  # share of (total / share)²
        freedom += 1
    if freedom < 1:
        return Uneven(driver, 1.0, 0.0, 0.0 * beyond)
    most = float(square.max())
    p = min(1.0, float(gammaincc(0.5 * freedom, 0.5 * most)) * len(square))
    return Uneven(driver, p, 0.5 * (most - freedom), np.sqrt(np.maximum(beyond, 0.0)))
