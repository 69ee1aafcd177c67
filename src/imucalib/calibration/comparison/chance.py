"""How far calibrations lie apart by chance, where power-ups scatter.

What readings leave open and what power-ups bring have sizes of their own, known from few of each.
In the directions of a bias the second decides alone, so that no one F holds: calibrations are drawn
with each part's true size as its estimate tells it, size² = estimate² ν / χ²(ν) (Fisher's fiducial
law). The size of what power-ups bring is one, for all.
"""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.comparison.basis import Basis
from imucalib.core.eigen import eigen

#: Calibrations that are drawn; p is no finer than one of as many and one.
DRAWS = 6000


def drawn(basis: Basis, rng: np.random.Generator) -> Array:
    """(DRAWS, m, p) values about a common truth."""
    assert basis.power_ups is not None
    m, p = basis.value.shape
    found = np.zeros((DRAWS, m, p))
    common = _size(basis.power_ups.dof, rng)
    for k, share in enumerate(basis.power_ups.share):
        own = basis.covariance[k] - share
        for part, size in ((own, _size(float(basis.dof[k]), rng)), (share, common)):
            found[:, k] += size[:, None] * (rng.standard_normal((DRAWS, p)) @ _root(part))
    return found


def exceeded(squares: Array, found: float) -> float:
    """p of a sum of squares beside those that are drawn."""
    return float((1 + np.count_nonzero(squares >= found)) / (squares.size + 1))


def _size(dof: float, rng: np.random.Generator) -> Array:
    if not np.isfinite(dof):
        return np.ones(DRAWS)
    return np.asarray(np.sqrt(dof / rng.chisquare(dof, DRAWS)))


def _root(covariance: Array) -> Array:
    values, vectors = eigen(0.5 * (covariance + covariance.T))
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T)
