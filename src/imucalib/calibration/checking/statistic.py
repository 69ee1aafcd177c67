"""The test of "nothing has changed", its exact level, and the change that it could have seen.

With whitened misfits z and the family's whitened columns of rank r and orthonormal basis U,

    F = |Uᵀ z|² / r   is F(r, ν) of an unchanged sensor,

since V's scale was estimated with ν degrees of freedom. The families and "anything" are tested
together: the smallest of their p is compared with the smallest in simulated recordings of an
unchanged sensor (Westfall and Young 1993, Resampling-Based Multiple Testing, ch. 2, minimum p),
in which each part of V has the sizes that its estimate allows.

The power is that of a change of stated size. The stated size goes with the estimated noise, so both
the threshold and the change are drawn at the same estimate: z = z₀ / √q + shift, q ~ χ²(ν) / ν of
each part.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import fdtrc

from imucalib.arrays import Array
from imucalib.calibration.checking.misfit import Misfits
from imucalib.core.eigen import eigen

ANYTHING = "anything"
#: Simulated recordings; p is no finer than 1 / (draws + 1).
DRAWS = 8000
#: Singular value of whitened columns, as a share of the largest, below which a direction is none.
_NONE = 1e-6


@dataclass(frozen=True)
class FamilyTest:
    """f, p : of one family by itself; rank : of its columns here
    size : (3,) estimated change per axis in the family's unit, sd : (3,); NaN where it is open
    rest : p of what the family leaves unexplained; 1 where nothing can be
    """

    f: float
    p: float
    rank: int
    size: Array
    sd: Array
    rest: float


@dataclass(frozen=True)
class Statistic:
    """A recording made ready for tests. seed : of the simulated recordings"""

    misfits: Misfits
    seed: int = 0
    draws: int = DRAWS

    @cached_property
    def white(self) -> Array:
        """(N,) whitened misfits."""
        return self.misfits.white(self.misfits.value)

    @cached_property
    def columns(self) -> Mapping[str, Array]:
        """Whitened columns of each family, (N, 3)."""
        return {name: self.misfits.white(c) for name, c in self.misfits.changes.items()}

    @cached_property
    def _span(self) -> Array:
        """(N, R) orthonormal basis of all families."""
        return _basis(np.concatenate(list(self.columns.values()), axis=1))

    @cached_property
    def _bases(self) -> dict[str, Array]:
        """Of each family, in the coordinates of the common basis."""
        return {name: _basis(self._span.T @ c) for name, c in self.columns.items()}

    @cached_property
    def _beyond(self) -> int:
        return int(self.white.size - self._span.shape[1])

    def tested(self) -> dict[str, FamilyTest]:
        """Every family by itself, and "anything"."""
        inside, dof, n = self._span.T @ self.white, self.misfits.dof, self.white.size
        whole = float(self.white @ self.white)
        found = {}
        for name, basis in self._bases.items():
            rank, power = basis.shape[1], float(np.sum((basis.T @ inside) ** 2))
            free = n - rank
            rest = float(fdtrc(free, dof, (whole - power) / free)) if free else 1.0
            p = float(fdtrc(rank, dof, power / rank)) if rank else 1.0
            found[name] = FamilyTest(power / max(rank, 1), p, rank, *self._estimate(name), rest)
        p = float(fdtrc(n, dof, whole / n))
        empty = np.zeros(0)
        return found | {ANYTHING: FamilyTest(whole / n, p, n, empty, empty, 1.0)}

    def rest_of_all(self) -> float | None:
        """p of what all families together leave unexplained; None where nothing can be."""
        free, inside = self._beyond, self._span.T @ self.white
        power = float(self.white @ self.white - inside @ inside)
        return float(fdtrc(free, self.misfits.dof, power / free)) if free else None

    def _estimate(self, name: str) -> tuple[Array, Array]:
        """Generalised least squares of a family alone; NaN where a direction is open."""
        columns = self.columns[name]
        if self.worst(name) is None:
            return np.full(3, np.nan), np.full(3, np.nan)
        covariance = np.linalg.inv(columns.T @ columns)
        return covariance @ columns.T @ self.white, np.sqrt(np.diag(covariance))

    def p(self) -> float:
        """Of the smallest p of all families, for an unchanged sensor."""
        own = min(test.p for test in self.tested().values())
        return float((1 + np.count_nonzero(self._least <= own)) / (self.draws + 1))

    @cached_property
    def _null(self) -> tuple[Array, Array]:
        """Whitened misfits of unchanged sensors by the stated noise: (draws, R) in the common
        basis, and (draws,) the squares of what lies beyond it."""
        white = self.misfits.drawn(np.random.default_rng([self.seed, 11]), self.draws)
        inside = white @ self._span
        beyond = np.sum(white**2, axis=1) - np.sum(inside**2, axis=1)
        return inside, np.maximum(beyond, 0.0) * (self._beyond > 0)

    @cached_property
    def _least(self) -> Array:
        return self._smallest_p(*self._null)

    def _smallest_p(self, inside: Array, beyond: Array) -> Array:
        """(draws,) smallest p over families and anything."""
        dof, n = self.misfits.dof, self.white.size
        least = fdtrc(n, dof, (np.sum(inside**2, axis=1) + beyond) / n)
        for basis in self._bases.values():
            if rank := basis.shape[1]:
                power = np.sum((inside @ basis) ** 2, axis=1)
                least = np.minimum(least, fdtrc(rank, dof, power / rank))
        return np.asarray(least, np.float64)

    def power(self, family: str, change: Array, alpha: float = 0.05) -> float:
        """Chance that a change (3,) in the family's unit is found at level alpha."""
        bar = np.quantile(self._least, alpha)
        inside, beyond = self._null
        moved = inside + self._span.T @ self.columns[family] @ change
        return float(np.mean(self._smallest_p(moved, beyond) < bar))

    def worst(self, family: str) -> Array | None:
        """(3,) the direction in which a change of a family shows least; None where one is open."""
        gram = self.columns[family].T @ self.columns[family]
        values, vectors = eigen(gram)
        return None if values[0] <= _NONE**2 * max(values[-1], 1e-300) else vectors[:, 0]

    def seen(self, family: str, *, alpha: float = 0.05, power: float = 0.9) -> float:
        """Smallest change, in the direction that shows least, that is found with this power;
        infinite where these attitudes cannot show it."""
        from scipy.optimize import brentq

        direction = self.worst(family)
        if direction is None:
            return float("inf")
        unit = float(np.linalg.norm(self.columns[family] @ direction))
        low, high = 0.0, 6.0 / unit
        while self.power(family, high * direction, alpha) < power and high * unit < 1e4:
            low, high = high, 2.0 * high

        def short(size: float) -> float:
            return self.power(family, size * direction, alpha) - power

        return float(brentq(short, low, high, xtol=2e-3 / unit))


def _basis(columns: Array) -> Array:
    """Orthonormal basis, without directions that are only rounding. Columns of families in other
    units weigh the same: each is scaled to length one first."""
    length = np.linalg.norm(columns, axis=0)
    scaled = columns[:, length > 0.0] / length[length > 0.0]
    if not scaled.size:
        return np.zeros((len(columns), 0))
    u, s, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(u[:, s > _NONE * s[0]])
