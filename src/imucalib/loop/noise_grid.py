"""Evidence of candidates where settings have errors, maximised over a grid of noise hypotheses.

Each point of the grid fixes the ratios of the settings' scatter to the noise; the noise itself is
profiled in closed form. What depends on the data is separate from what does not, so simulated
data sets can follow in parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.core.balance import Whitener, whitener

#: Sizes of a candidate, in its typical size, over which the evidence is maximised.
TAU = np.array([0.1, 0.3, 1.0, 3.0, 10.0])
#: Variance components are re-estimated on this grid of factors of the fitted ratio. The fitted
#: ratio itself is left out: the data would sit on a grid point and simulated data beside one.
SHRINK = (0.0, 0.15, 0.4, 0.72, 0.92, 1.15, 1.6)


@dataclass(frozen=True)
class _Point:
    """One noise hypothesis: directions (N, M) of all candidates after projection, their squared
    sizes, and the part of the log likelihood that no candidate changes."""

    white: Whitener
    basis: Array
    u: Array
    size: Array
    constant: float


class EvidenceGrid:
    """Blocks of columns against data sets, all in units of the fitted noise factor.

    jacobian : (N, p) of the fitted parameters; settings : the components' matrices N_c
    ratio : fitted sd of each component over the noise factor
    blocks : (N, m_k) columns of each candidate at typical size
    """

    def __init__(
        self,
        jacobian: Array,
        settings: tuple[Array, ...],
        ratio: tuple[float, ...],
        blocks: Sequence[Array],
    ) -> None:
        columns = np.column_stack(blocks)
        self._starts = np.cumsum([0] + [b.shape[1] for b in blocks])[:-1]
        grids = [tuple(factor * r for factor in SHRINK) for r in ratio]
        self._points = [
            _at_point(jacobian, whitener(settings, point), columns, self._starts)
            for point in product(*grids)
        ]

    def evidence(self, data: Array) -> Array:
        """(candidates, data sets) evidence in nats of data (N, data sets)."""
        nothing: Array = np.full(data.shape[1], -np.inf)
        best: Array = np.full((len(self._starts), data.shape[1]), -np.inf)
        for point in self._points:
            white = point.white(data)
            white = white - point.basis @ (point.basis.T @ white)
            power = np.einsum("ij,ij->j", white, white)
            freedom = data.shape[0] - point.basis.shape[1]
            np.maximum(nothing, point.constant - 0.5 * freedom * np.log(power), out=nothing)
            explained = (point.u.T @ white) ** 2
            for tau in TAU:
                gain = tau**2 * point.size
                share = (gain / (1.0 + gain))[:, None]
                drop = np.add.reduceat(share * explained, self._starts, axis=0)
                penalty = np.add.reduceat(np.log1p(gain), self._starts)[:, None]
                rest = np.maximum(power - drop, 1e-300)
                value = point.constant - 0.5 * (freedom * np.log(rest) + penalty)
                np.maximum(best, value, out=best)
        return best - nothing


def _at_point(jacobian: Array, white: Whitener, columns: Array, starts: NDArray[np.intp]) -> _Point:
    basis, triangle = np.linalg.qr(white(jacobian))
    projected = white(columns)
    projected = projected - basis @ (basis.T @ projected)
    u, size = projected.copy(), np.zeros(columns.shape[1])
    for first, last in zip(starts, [*starts[1:], columns.shape[1]], strict=True):
        block = projected[:, first:last]
        if last - first == 1:
            size[first] = float(block[:, 0] @ block[:, 0])
            u[:, first] = block[:, 0] / np.sqrt(max(size[first], 1e-300))
            continue
        # Eigenvectors of the small Gram matrix are the block's singular directions.
        values, vectors = np.linalg.eigh(block.T @ block)
        size[first:last] = np.maximum(values, 0.0)
        u[:, first:last] = block @ vectors / np.sqrt(np.maximum(values, 1e-300))
        u[:, first:last][:, values <= 1e-12 * values[-1]] = 0.0
    log_j = float(np.log(np.maximum(np.abs(np.diag(triangle)), 1e-300)).sum())
    return _Point(white, basis, u, size, -0.5 * white.log_det - log_j)
