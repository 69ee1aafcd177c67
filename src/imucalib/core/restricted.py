"""What a balance says once the fitted parameters are taken out: the restricted likelihood.

With K an orthonormal complement of J, the likelihood of K'r is the restricted one (Patterson and
Thompson 1971): no parameter is left in it, so that noise can be varied without a projection each
time. The widest component, noise that neighbours share, is made diagonal once; beside it the
settings are few columns (Woodbury 1950):

    V(ratio) = diag(1 + ρ_w² Λ) + U U',   U = [ρ_c K'N_c]

Over a grid of ratios one of them is diagonal too, beside each choice of the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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

    def at(self, ratio: Array) -> Covariance:
        """The covariance at ratios sd_c / s (components,)."""
        return Covariance(self._diagonal(ratio), self.columns, ratio[self.owner])

    def _diagonal(self, ratio: Array) -> Array:
        one = np.ones(self.frame.shape[1])
        return one + ratio[self.wide] ** 2 * self.spread if self.wide >= 0 else one

    def over(self, ratio: Array, most: int) -> Iterator[Covariances]:
        """The covariances at distinct ratios (P, components), up to so many at a time of all but
        the component that follows at once: the narrow one of most columns."""
        count = np.bincount(self.owner, minlength=ratio.shape[1])
        fast = int(np.argmax(count)) if self.owner.size else -1
        slow = np.where(np.arange(ratio.shape[1]) == fast, 0.0, ratio)
        points, of = np.unique(slow, axis=0, return_inverse=True)
        sizes = [ratio[of == k, fast] if fast >= 0 else np.zeros(1) for k in range(len(points))]
        wide = points[:, self.wide] if self.wide >= 0 else np.zeros(len(points))
        alike: dict[tuple[float, ...], list[int]] = {}
        for k, own in enumerate(sizes):
            alike.setdefault((float(wide[k]), *own.tolist()), []).append(k)
        for some in alike.values():
            for a in range(0, len(some), most):
                yield self._beside(points[some[a : a + most]], fast, sizes[some[0]])

    def _beside(self, slow: Array, fast: int, sizes: Array) -> Covariances:
        """slow : (P, components), one ratio of the wide component; sizes : (F,) of the fast one."""
        root = np.sqrt(self._diagonal(slow[0]))
        columns, held = self.columns / root[:, None], self.owner != fast
        turn, size = _directions(columns[:, held], self.owner[held], slow)
        within = _shrunk(columns[:, ~held], turn, size)
        along, spread, _ = np.linalg.svd(within, full_matrices=False)
        weight = 1.0 / (1.0 + (sizes[:, None] * spread[:, None]) ** 2)
        log_det = 2.0 * np.log(root).sum() + np.log1p(size**2).sum(axis=1)[:, None]
        return Covariances(root, turn, size, along, weight, log_det - np.log(weight).sum(axis=2))


def _directions(columns: Array, owner: Index, ratio: Array) -> tuple[Array, Array]:
    """Singular directions (P, n, q) and values (P, q) of columns (n, q) times their ratios."""
    if columns.shape[1] and (owner == owner[0]).all():
        turn, size, _ = np.linalg.svd(columns, full_matrices=False)
        return np.broadcast_to(turn, (len(ratio), *turn.shape)), ratio[:, owner[:1]] * size
    turn, size, _ = np.linalg.svd(columns * ratio[:, None, owner], full_matrices=False)
    return turn, size


def _shrunk(data: Array, turn: Array, size: Array) -> Array:
    """(P, n, D) of (1 + turn size² turn')^-½ data, data (n, D)."""
    less = (1.0 - 1.0 / np.sqrt(1.0 + size**2))[..., None]
    return np.asarray(data - turn @ (less * (turn.swapaxes(-1, -2) @ data)))


@dataclass(frozen=True)
class Covariances:
    """V / s² = W⁻¹ (1 + L r² σ² L') W⁻¹' at P ratios of all components but one, each with F of that
    one: a change of its ratio r changes weights and nothing else.

    root : (n,) standard deviations without the narrow components; turn, size : (P, n, q), (P, q) of
    the others; along : (P, n, f) orthonormal L; weight : (P, F, f) 1 / (1 + r² σ²);
    log_det : (P, F)
    """

    root: Array
    turn: Array
    size: Array
    along: Array
    weight: Array
    log_det: Array

    def split(self, data: Array) -> tuple[Array, Array]:
        """Data (n, D) in units of all but the fast component, square to L (P, n, D) and along it
        (P, f, D): y'V⁻¹y is the sum of squares of the first and of the weighted ones of the
        second, which loses no digits however large settings are."""
        white = _shrunk(data / self.root[:, None], self.turn, self.size)
        along = self.along.swapaxes(-1, -2) @ white
        return white - self.along @ along, along


@dataclass(frozen=True)
class Covariance:
    """V / s² = diag(diagonal) + U U', U = columns * size, columns (n, q), size (q,)."""

    diagonal: Array
    columns: Array
    size: Array

    @cached_property
    def _factors(self) -> tuple[Array, Array, Array]:
        """Q₁ (n, q), Q₂ (q, q) and |diag R| (q,) of [diag^-½ U; 1] = [Q₁; Q₂] R.

        V⁻¹ = diag^-½ (1 - Q₁Q₁') diag^-½: settings as large as may be cost no digits, as they do
        where (1 + U'U)⁻¹ is formed.
        """
        above = self.columns / np.sqrt(self.diagonal)[:, None] * self.size
        q, r = np.linalg.qr(np.concatenate([above, np.eye(self.size.size)]))
        n = len(self.diagonal)
        return q[:n], q[n:], np.abs(np.diagonal(r))

    @cached_property
    def inside(self) -> Array:
        """(q, q) of (1 + U' diag⁻¹ U)⁻¹."""
        below = self._factors[1]
        return np.asarray(below @ below.T)

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
