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
    def root(self) -> Array:
        """(n,) standard deviations without the columns."""
        return np.sqrt(self.diagonal)

    @cached_property
    def _factors(self) -> tuple[Array, Array, Array]:
        """Q₁ (P, n, q), Q₂ (P, q, q) and |diag R| (P, q) of [diag^-½ U; 1] = [Q₁; Q₂] R.

        V⁻¹ = diag^-½ (1 - Q₁Q₁') diag^-½: settings as large as may be cost no digits, as they do
        where (1 + U'U)⁻¹ is formed.
        """
        above = (self.columns / self.root[:, None]) * self.size[:, None]
        below = np.broadcast_to(np.eye(self.size.shape[1]), (*self.size.shape, self.size.shape[1]))
        q, r = np.linalg.qr(np.concatenate([above, below], axis=1))
        n = len(self.diagonal)
        return q[:, :n], q[:, n:], np.abs(np.diagonal(r, axis1=1, axis2=2))

    @cached_property
    def inside(self) -> Array:
        """(P, q, q) of (1 + U' diag⁻¹ U)⁻¹."""
        below = self._factors[1]
        return np.asarray(below @ below.swapaxes(-1, -2))

    @cached_property
    def log_det(self) -> Array:
        """(P,)"""
        return np.asarray(np.log(self.diagonal).sum() + 2.0 * np.log(self._factors[2]).sum(axis=1))

    def along(self, data: Array) -> Array:
        """(P, q, D) of data (n, D) over their sds, along Q₁: what V⁻¹ lacks of the plain square."""
        return self._factors[0].swapaxes(-1, -2) @ (data / self.root[:, None])

    def solve(self, data: Array) -> tuple[Array, Array]:
        """V⁻¹ data (P, n, D) and what the columns take of it (P, q, D), in units of their sd."""
        along = self.along(data)
        rest = data / self.root[:, None] - self._factors[0] @ along
        return rest / self.root[:, None], self._factors[1] @ along

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
