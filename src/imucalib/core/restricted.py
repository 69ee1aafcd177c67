"""What a balance says once the fitted parameters are taken out: the restricted likelihood.

With K an orthonormal complement of J, the likelihood of K'r is the restricted one (Patterson and
Thompson 1971): no parameter is left in it, so that noise can be varied without a projection each
time. The widest component, noise that neighbours share, is made diagonal once; beside it the
settings are few columns (Woodbury 1950):

    V(ratio) = diag(1 + ρ_w² Λ) + U U',   U = [ρ_c K'N_c]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.eigen import eigen

#: A pivot below this share of the largest is a direction that the data leave open.
_OPEN = 1e-13


@dataclass(frozen=True)
class Restricted:
    """Data and components after the parameters are out, n of them.

    frame : (N, n) orthonormal, into the axes in which the wide component is diagonal
    columns : (n, q) the narrow components side by side; owner : (q,) the component of each
    wide : which component is diagonal, or -1; spread : (n,) its Λ
    """

    frame: Array
    columns: Array
    owner: Index
    wide: int
    spread: Array

    def at(self, ratio: Sequence[Sequence[float]] | Array) -> Covariances:
        """The covariances at ratios sd_c / s (P, components), which have one ratio of the wide
        component."""
        size = np.asarray(ratio, np.float64)
        diagonal = np.ones(self.frame.shape[1])
        if self.wide >= 0:
            diagonal = diagonal + size[0, self.wide] ** 2 * self.spread
        return Covariances(diagonal, self.columns, size[:, self.owner])


@dataclass(frozen=True)
class Covariances:
    """P of V / s² = diag(diagonal) + U U', U = columns * size, columns (n, q), size (P, q)."""

    diagonal: Array
    columns: Array
    size: Array

    @cached_property
    def weighted(self) -> Array:
        """(n, q) of the columns over the diagonal."""
        return self.columns / self.diagonal[:, None]

    @cached_property
    def _capacity(self) -> Array:
        inner = self.columns.T @ self.weighted
        outer = self.size[:, :, None] * self.size[:, None]
        return np.eye(self.size.shape[1]) + outer * inner

    @cached_property
    def inside(self) -> Array:
        """(P, q, q) of (1 + U' diag⁻¹ U)⁻¹."""
        return np.asarray(np.linalg.inv(self._capacity), np.float64)

    @cached_property
    def log_det(self) -> Array:
        """(P,)"""
        capacity = np.linalg.slogdet(self._capacity)[1]
        return np.asarray(np.log(self.diagonal).sum() + capacity)

    def solve(self, data: Array) -> tuple[Array, Array]:
        """V⁻¹ data (P, n, D) and what the columns take of it (P, q, D), in units of their sd."""
        taken = self.inside @ (self.size[:, :, None] * (self.weighted.T @ data))
        rest = data - self.columns @ (self.size[:, :, None] * taken)
        return rest / self.diagonal[:, None], taken

    def power(self, solved: tuple[Array, Array]) -> Array:
        """(P, D) of data' V⁻¹ data, as a sum of squares: a difference would lose what large
        settings leave."""
        rest, taken = solved
        return np.asarray((self.diagonal[:, None] * rest**2).sum(axis=1) + (taken**2).sum(axis=1))


def restricted(jacobian: Array, settings: Sequence[Array]) -> Restricted:
    """Take the parameters (N, p) out of a balance with components (N, q_c)."""
    frame = _complement(jacobian)
    parts = [frame.T @ matrix for matrix in settings]
    widest = max(range(len(parts)), key=lambda c: parts[c].shape[1], default=-1)
    spread = np.zeros(0)
    if widest >= 0 and 2 * parts[widest].shape[1] > frame.shape[1]:
        spread, turn = eigen(parts[widest] @ parts[widest].T)
        spread, frame = np.maximum(spread, 0.0), frame @ turn
        parts = [turn.T @ part for part in parts]
    else:
        widest = -1
    narrow = [c for c in range(len(parts)) if c != widest]
    columns = [parts[c] for c in narrow]
    owner = np.repeat(narrow, [part.shape[1] for part in columns]).astype(np.intp)
    side = np.column_stack(columns) if columns else np.zeros((frame.shape[1], 0))
    return Restricted(frame, side, owner, widest, spread)


def _complement(jacobian: Array) -> Array:
    """(N, N - rank) orthonormal, square to every column."""
    from scipy.linalg import qr

    scale = np.linalg.norm(jacobian, axis=0)
    q, r, _ = qr(jacobian / np.where(scale > 0.0, scale, 1.0), pivoting=True, check_finite=False)
    pivots = np.abs(np.diag(r))
    return np.asarray(q[:, int(np.sum(pivots > _OPEN * pivots.max(initial=0.0))) :])
