"""What a balance says once the fitted parameters are taken out: the restricted likelihood.

That of K'r with K an orthonormal complement of J (Patterson and Thompson 1971): no parameter is
left in it. The component with most columns is made diagonal once, the others are few columns
(Woodbury 1950):

    V(ratio) = diag(1 + ρ_w² Λ) + U U',   U = [ρ_c K'N_c]

Over a grid of ratios one of them is diagonal too, beside each choice of the others. Where the
widest joins few readings at a time, as settings do, it is made diagonal block by block, and K is
never formed: J stands beside U, with an infinite variance. Noise that all neighbours share is one
block, and there K comes first.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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
    wide : which component is diagonal, or -1; spread : (n,) its Λ
    """

    frame: Array | csr_array
    out: Array
    columns: Array
    owner: Index
    wide: int
    spread: Array

    @property
    def freedom(self) -> int:
        """Numbers less parameters."""
        return len(self.out) - int(self.out.shape[1])

    def turned(self, data: Array) -> Array:
        """Data (N, ...) in these axes (n, ...)."""
        return np.asarray(self.frame.T @ data)

    def at(self, ratio: Array) -> Covariance:
        """The covariance at ratios sd_c / s (components,)."""
        return Covariance(self._diagonal(ratio), self.out, self.columns, ratio[self.owner])

    def _diagonal(self, ratio: Array) -> Array:
        one = np.ones((*ratio.shape[:-1], self.frame.shape[1]))
        return one + ratio[..., [self.wide]] ** 2 * self.spread if self.wide >= 0 else one

    def over(self, ratio: Array, most: int) -> Iterator[Covariances]:
        """The covariances at distinct ratios (P, components), up to so many at a time of all but
        the component that follows at once: the narrow one of most columns."""
        count = np.bincount(self.owner, minlength=ratio.shape[1])
        fast = int(np.argmax(count)) if self.owner.size else -1
        slow = np.where(np.arange(ratio.shape[1]) == fast, 0.0, ratio)
        points, of = np.unique(slow, axis=0, return_inverse=True)
        sizes = [ratio[of == k, fast] if fast >= 0 else np.zeros(1) for k in range(len(points))]
        alike: dict[tuple[float, ...], list[int]] = {}
        for k, own in enumerate(sizes):
            alike.setdefault(tuple(own.tolist()), []).append(k)
        for some in alike.values():
            for a in range(0, len(some), most):
                yield self._beside(points[some[a : a + most]], fast, sizes[some[0]])

    def _beside(self, slow: Array, fast: int, sizes: Array) -> Covariances:
        """slow : (P, components); sizes : (F,) ratios of the fast one."""
        root, held = np.sqrt(self._diagonal(slow)), self.owner != fast
        columns = self.columns / root[..., None]
        turn, size, _ = np.linalg.svd(
            columns[..., held] * slow[:, None, self.owner[held]], full_matrices=False
        )
        every = np.concatenate([self.out / root[..., None], columns[..., ~held]], axis=2)
        # One orthonormal basis of both: singular vectors of what the parameters have taken away
        # would be square to them by chance only.
        basis, corner = np.linalg.qr(_shrunk(every, turn, size))
        r = self.out.shape[1]
        rotated, spread, _ = np.linalg.svd(corner[:, r:, r:], full_matrices=False)
        along = basis[..., r:] @ rotated
        weight = 1.0 / (1.0 + (sizes[:, None] * spread[:, None]) ** 2)
        log_det = 2.0 * np.log(root).sum(axis=1) + np.log1p(size**2).sum(axis=1)
        taken = np.diagonal(corner[:, :r, :r], axis1=1, axis2=2)
        log_det += 2.0 * np.log(np.abs(taken)).sum(axis=1)
        both = np.concatenate([basis[..., :r], along], axis=2)
        logs = log_det[:, None] - np.log(weight).sum(axis=2)
        return Covariances(root, turn, size, both, weight, logs)


def _shrunk(data: Array, turn: Array, size: Array) -> Array:
    """(P, n, D) of (1 + turn size² turn')^-½ data, data (P, n, D)."""
    if not size.size:
        return data
    less = (1.0 - 1.0 / np.sqrt(1.0 + size**2))[..., None]
    return np.asarray(data - turn @ (less * (turn.swapaxes(-1, -2) @ data)))


@dataclass(frozen=True)
class Covariances:
    """V / s² = W⁻¹ (1 + L r² σ² L') W⁻¹' at P ratios of all components but one, each with F of that
    one: a change of its ratio r changes weights and nothing else.

    root : (P, n) standard deviations without the narrow components; turn, size : (P, n, q), (P, q)
    of the slow ones of these; basis : (P, n, r + f) orthonormal, what of the parameters is still to
    be taken out, and L; weight : (P, F, f) 1 / (1 + r² σ²); log_det : (P, F)
    """

    root: Array
    turn: Array
    size: Array
    basis: Array
    weight: Array
    log_det: Array

    def split(self, data: Array) -> tuple[Array, Array]:
        """Data (n, D) in units of all but the fast component, square to L (P, n, D) and along it
        (P, f, D): y'V⁻¹y is the sum of squares of the first and of the weighted ones of the
        second, which loses no digits however large settings are."""
        white = _shrunk(data / self.root[..., None], self.turn, self.size)
        within = self.basis.swapaxes(-1, -2) @ white
        white -= self.basis @ within
        return white, within[:, within.shape[1] - self.weight.shape[2] :]

    def sizes(self, data: Array) -> Array:
        """(P, D) squared length of data (n, D), the narrow components not yet seen."""
        return np.asarray((1.0 / self.root**2) @ data**2)


@dataclass(frozen=True)
class Covariance:
    """V / s² = diag(diagonal) + U U', U = columns * size, columns (n, q), size (q,), and beside it
    an infinite variance along out (n, r)."""

    diagonal: Array
    out: Array
    columns: Array
    size: Array

    @cached_property
    def _factors(self) -> tuple[Array, Array, Array]:
        """Q₁ (n, r + q), Q₂ (q, r + q) and |diag R| of [diag^-½ [out, U]; 0, 1] = [Q₁; Q₂] R.

        V⁻¹ = diag^-½ (1 - Q₁Q₁') diag^-½: settings as large as may be cost no digits, as they do
        where (1 + U'U)⁻¹ is formed.
        """
        above = np.concatenate([self.out, self.columns * self.size], axis=1)
        below = np.eye(self.size.size, above.shape[1], self.out.shape[1])
        q, r = np.linalg.qr(np.concatenate([above / np.sqrt(self.diagonal)[:, None], below]))
        n = len(self.diagonal)
        return q[:n], q[n:], np.abs(np.diagonal(r))

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


def restricted(jacobian: Array, settings: Sequence[Array]) -> Restricted:
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
    return Restricted(frame, out, side, owner, wide, spread)


def _along(jacobian: Array, mode: Literal["full", "economic"]) -> tuple[Array, int]:
    """Orthonormal (N, N) or (N, p), of which so many first columns lie along the Jacobian's."""
    from scipy.linalg import qr

    scale = np.linalg.norm(jacobian, axis=0)
    unit = jacobian / np.where(scale > 0.0, scale, 1.0)
    q, r, _ = qr(unit, pivoting=True, mode=mode, check_finite=False)
    pivots = np.abs(np.diag(r))
    return np.asarray(q), int(np.sum(pivots > _OPEN * pivots.max(initial=0.0)))
