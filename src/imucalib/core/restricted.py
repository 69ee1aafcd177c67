"""What a balance says once the fitted parameters are taken out: the restricted likelihood.

That of K'r with K an orthonormal complement of J (Patterson and Thompson 1971): no parameter is
left in it. The component with most columns is made diagonal once, the others are few columns
(Woodbury 1950):

    V(ratio) = diag(1 + ρ_w² Λ) + U U',   U = [ρ_c K'N_c]

Where the widest joins few readings at a time, as settings do, it is made diagonal block by block,
and K is never formed: J joins U, with an infinite variance. Noise that all neighbours share is one
block, and there K comes first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.eigen import blocks_of, eigen, eigen_by_blocks

if TYPE_CHECKING:
    from scipy.sparse import csr_array

#: A pivot below this share of the largest is a direction that the data leave open.
_OPEN = 1e-13


@dataclass(frozen=True)
class Restricted:
    """Data and components in n axes in which the widest component is diagonal.

    frame : (N, n) orthonormal, into those axes; out : (n, r) orthonormal, what of the parameters is
        not yet taken out
    columns : (n, q) the narrow components side by side; owner : (q,) the component of each
    blocks : as these come apart, rows (b, m) and columns (b, k) of all blocks of one shape
    wide : which component is diagonal, or -1; spread : (n,) its Λ
    """

    frame: Array | csr_array
    out: Array
    columns: Array
    owner: Index
    blocks: tuple[tuple[Index, Index], ...]
    wide: int
    spread: Array

    def turn(self, data: Array) -> Array:
        """Data (N, ...) in these axes (n, ...)."""
        return np.asarray(self.frame.T @ data)

    def at(self, ratio: Array) -> LowRankCovariance:
        """The covariance at ratios sd_c / s (components,)."""
        diagonal = np.ones(self.frame.shape[1])
        if self.wide >= 0:
            diagonal += ratio[self.wide] ** 2 * self.spread
        return LowRankCovariance(diagonal, self.out, self.columns, ratio[self.owner], self.blocks)


@dataclass(frozen=True)
class LowRankCovariance:
    """V / s² = diag(diagonal) + U U', U = columns * size, columns (n, q), size (q,), and beside it
    an infinite variance along out (n, r); blocks : of the columns, as `Restricted` has them"""

    diagonal: Array
    out: Array
    columns: Array
    size: Array
    blocks: tuple[tuple[Index, Index], ...]

    @cached_property
    def _factors(self) -> tuple[Array, Array, Array]:
        """Q₁ (n, q + r), Q₂ (q, q + r) and |diag R| of [diag^-½ [U, out]; 1, 0] = [Q₁; Q₂] R.

        V⁻¹ = diag^-½ (1 - Q₁Q₁') diag^-½: settings as large as may be cost no digits, as they do
        where (1 + U'U)⁻¹ is formed. U comes apart into blocks; what is left of out beside it is
        formed twice, so that it is orthogonal (Giraud et al. 2005).
        """
        (n, q), root = self.columns.shape, np.sqrt(self.diagonal)[:, None]
        basis, size = np.zeros((n + q, q)), np.ones(q)
        for rows, some in self.blocks:
            m, k = rows.shape[1], some.shape[1]
            own = self.columns[rows[:, :, None], some[:, None]] * self.size[some][:, None]
            unit = np.broadcast_to(np.eye(k), (len(rows), k, k))
            part, r = np.linalg.qr(np.concatenate([own / root[rows], unit], axis=1))
            basis[rows[:, :, None], some[:, None]] = part[:, :m]
            basis[n + some[:, :, None], some[:, None]] = part[:, m:]
            size[some] = np.abs(np.diagonal(r, axis1=1, axis2=2))
        rest = np.concatenate([self.out / root, np.zeros((q, self.out.shape[1]))])
        for _ in range(2):
            rest = rest - basis @ (basis.T @ rest)
        along, r = np.linalg.qr(rest)
        whole = np.concatenate([basis, along], axis=1)
        return whole[:n], whole[n:], np.append(size, np.abs(np.diagonal(r)))

    @cached_property
    def inside(self) -> Array:
        """(q,) diagonal of (1 + U' diag⁻¹ U)⁻¹, the parameters out."""
        return np.asarray(np.sum(self._factors[1] ** 2, axis=1))

    @property
    def own(self) -> Array:
        """(n,) diagonal of V⁻¹."""
        return np.asarray((1.0 - np.sum(self._factors[0] ** 2, axis=1)) / self.diagonal)

    @property
    def log_det(self) -> float:
        return float(np.log(self.diagonal).sum() + 2.0 * np.log(self._factors[2]).sum())

    def solve(self, data: Array) -> tuple[Array, Array]:
        """V⁻¹ data (n,) and what the columns take of it (q,), in units of their sd."""
        root = np.sqrt(self.diagonal)
        along = self._factors[0].T @ (data / root)
        rest = data / root - self._factors[0] @ along
        return rest / root, self._factors[1] @ along

    def power(self, solved: tuple[Array, Array]) -> float:
        """data' V⁻¹ data as a sum of squares: a difference would lose what large settings leave."""
        rest, taken = solved
        return float(self.diagonal @ rest**2 + taken @ taken)


def restrict(jacobian: Array, settings: Sequence[Array]) -> Restricted:
    """Take the parameters (N, p) out of a balance with components (N, q_c)."""
    widest = max(range(len(settings)), key=lambda c: settings[c].shape[1], default=-1)
    blocks = [] if widest < 0 else blocks_of(settings[widest])
    if len(blocks) > 1:
        spread, frame = eigen_by_blocks(settings[widest], blocks)
        out, rank = _along(np.asarray(frame.T @ jacobian), "economic")
        return _beside(frame, out[:, :rank], settings, widest, spread)
    every, rank = _along(jacobian, "full")
    whole = every[:, rank:]
    if widest < 0 or 2 * settings[widest].shape[1] <= whole.shape[1]:
        return _beside(whole, np.zeros((whole.shape[1], 0)), settings, -1, np.zeros(0))
    part = whole.T @ settings[widest]
    spread, turn = eigen(part @ part.T)
    out = np.zeros((whole.shape[1], 0))
    return _beside(whole @ turn, out, settings, widest, np.maximum(spread, 0.0))


def _beside(
    frame: Array | csr_array, out: Array, settings: Sequence[Array], wide: int, spread: Array
) -> Restricted:
    narrow = [c for c in range(len(settings)) if c != wide]
    columns = [np.asarray(frame.T @ settings[c]) for c in narrow]
    owner = np.repeat(narrow, [part.shape[1] for part in columns]).astype(np.intp)
    side = np.column_stack(columns) if columns else np.zeros((int(frame.shape[1]), 0))
    return Restricted(
        frame=frame,
        out=out,
        columns=side,
        owner=owner,
        blocks=_blocks(side),
        wide=wide,
        spread=spread,
    )


def _blocks(columns: Array) -> tuple[tuple[Index, Index], ...]:
    """As `Restricted` has them, of columns (n, q)."""
    shapes, owner = dict[tuple[int, int], list[tuple[Index, Index]]](), np.zeros(len(columns), int)
    every = blocks_of(columns) if columns.size else []
    for k, rows in enumerate(every):
        owner[rows] = k
    place = owner[np.argmax(columns != 0.0, axis=0)] if every else owner[:0]
    for k in np.unique(place):
        some = np.flatnonzero(place == k)
        shapes.setdefault((every[k].size, some.size), []).append((every[k], some))
    return tuple(
        (np.array([rows for rows, _ in own]), np.array([some for _, some in own]))
        for own in shapes.values()
    )


def _along(jacobian: Array, mode: Literal["full", "economic"]) -> tuple[Array, int]:
    """Orthonormal (N, N) or (N, p), of which so many first columns lie along the Jacobian's."""
    from scipy.linalg import qr

    scale = np.linalg.norm(jacobian, axis=0)
    unit = jacobian / np.where(scale > 0.0, scale, 1.0)
    q, r, _ = qr(unit, pivoting=True, mode=mode, check_finite=False)
    pivots = np.abs(np.diag(r))
    return np.asarray(q), int(np.sum(pivots > _OPEN * pivots.max(initial=0.0)))
