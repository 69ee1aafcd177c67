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
from imucalib.core.eigen import eigen

#: Sizes of a candidate, in its typical size, over which the evidence is maximised.
TAU = np.array([0.1, 0.3, 1.0, 3.0, 10.0])
#: Variance components are re-estimated on this grid of factors of the fitted ratio. The fitted
#: ratio itself is left out: the data would sit on a grid point and simulated data beside one.
SHRINK = (0.0, 0.15, 0.4, 0.72, 0.92, 1.15, 1.6)
#: The same beside noise that neighbours share, and inside folds.
_COARSE = (0.0, 0.4, 0.92, 1.6)
#: The same of what sessions share: effects within a session do not explain it.
_HELD = (0.92,)


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
    without : the same ratios where the last component, noise that neighbours share, is left out: it
        may have taken over what a candidate explains, and the other components with it
    coarse : fewer hypotheses of the noise, for a part of data whose whole has been searched
    held : first and end of the components that sessions share
    """

    def __init__(
        self,
        jacobian: Array,
        settings: tuple[Array, ...],
        ratio: tuple[float, ...],
        blocks: Sequence[Array],
        without: tuple[float, ...] | None = None,
        coarse: bool = False,
        held: tuple[int, int] = (0, 0),
    ) -> None:
        columns = np.column_stack(blocks)
        self._starts = np.cumsum([0] + [b.shape[1] for b in blocks])[:-1]
        shrink = _COARSE if coarse else SHRINK
        points = _around(ratio, shrink if without is None else _COARSE, held)
        if without is not None:
            points += [(*point, 0.0) for point in _around(without, shrink, held)]
        self._points = [
            _at_point(jacobian, whitener(settings, point), columns, self._starts)
            for point in dict.fromkeys(points)
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


def _around(
    ratio: tuple[float, ...], shrink: tuple[float, ...], held: tuple[int, int]
) -> list[tuple[float, ...]]:
    each = (_HELD if held[0] <= k < held[1] else shrink for k in range(len(ratio)))
    sizes = zip(ratio, each, strict=True)
    return list(product(*(tuple(dict.fromkeys(s * r for s in some)) for r, some in sizes)))


def _at_point(jacobian: Array, white: Whitener, columns: Array, starts: NDArray[np.intp]) -> _Point:
    basis, triangle = np.linalg.qr(white(jacobian))
    projected = white(columns)
    projected = projected - basis @ (basis.T @ projected)
    u, size = np.empty_like(projected), np.zeros(columns.shape[1])
    widths = np.diff([*starts, columns.shape[1]])
    for width in np.unique(widths):
        # Eigenvectors of the small Gram matrices are the blocks' singular directions; blocks of
        # one width are decomposed together.
        at = starts[widths == width][:, None] + np.arange(width)
        blocks = projected[:, at].transpose(1, 0, 2)
        values, vectors = eigen(blocks.transpose(0, 2, 1) @ blocks)
        size[at] = np.maximum(values, 0.0)
        turned = blocks @ (vectors / np.sqrt(np.maximum(values, 1e-300))[:, None, :])
        turned[np.broadcast_to((values <= 1e-12 * values[:, -1:])[:, None, :], turned.shape)] = 0.0
        u[:, at] = turned.transpose(1, 0, 2)
    log_j = float(np.log(np.maximum(np.abs(np.diag(triangle)), 1e-300)).sum())
    return _Point(white, basis, u, size, -0.5 * white.log_det - log_j)
