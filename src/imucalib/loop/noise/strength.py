"""What the fitted parameters leave of each candidate, how strong it is, and what it explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.core.eigen import eigen
from imucalib.core.fit import Fit
from imucalib.loop.thresholds import ABSORBED

#: A squared size below this share of its block's largest is rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Strengths:
    """Of each candidate (k,): the share of its columns that the fitted parameters leave, its λ at
    typical size, and the share of the residual power that it explains; both zero where it is
    absorbed."""

    left: Array
    strength: Array
    share: Array

    @property
    def live(self) -> Array:
        """(k,) which are not absorbed."""
        return np.asarray(self.left >= ABSORBED)


def strengths(fit: Fit, blocks: Sequence[Array]) -> Strengths:
    """Of blocks (N, m_k) in the balance's units, one a candidate."""
    white, basis = fit.white_basis()
    residual = white(fit.at.residual)
    residual = residual - basis @ (basis.T @ residual)
    widths = np.array([block.shape[1] for block in blocks])
    starts = np.cumsum([0, *widths])[:-1]
    columns = white(np.column_stack(blocks))
    rest = columns - basis @ (basis.T @ columns)
    whole, kept = (np.add.reduceat((c**2).sum(axis=0), starts) for c in (columns, rest))
    left = np.divide(kept, whole, out=np.zeros_like(kept), where=whole > 0.0)
    live, share = left >= ABSORBED, np.zeros(len(widths))
    power = max(float(residual @ residual), 1e-300)
    freedom = residual.size - basis.shape[1]
    for width in np.unique(widths):
        which = np.flatnonzero((widths == width) & live)
        explained, rank = _explained(rest.T[starts[which, None] + np.arange(width)], residual)
        unexplained = (1.0 - explained / power) * freedom / np.maximum(freedom - rank, 1.0)
        share[which] = np.maximum(1.0 - unexplained, 0.0)
    return Strengths(left, np.where(live, np.sqrt(kept) / fit.noise.factor, 0.0), share)


def _explained(blocks: Array, residual: Array) -> tuple[Array, Array]:
    """Power of the residual (N,) along blocks (k, m, N), and how many directions each has."""
    values, vectors = eigen(blocks @ blocks.transpose(0, 2, 1))
    along = (vectors.transpose(0, 2, 1) @ (blocks @ residual)[..., None])[..., 0]
    open_ = values > _ROUNDING * values[:, -1:]
    parts = np.divide(along**2, values, out=np.zeros_like(values), where=open_)
    return parts.sum(axis=1), open_.sum(axis=1)
