"""Products of the problem's columns at every noise: all that the search, folds and words ever see.

    A = Zᵀ V⁻¹ Z - Σ Xᵀ X,  Z = [base | members | y]

What is integrated out leaves as factors X: a block of columns S with a normal prior of size τ as
L⁻¹ A_S, L Lᵀ = A_SS + 1/τ² (`marginalize`). Numbers that are left out are free, each by a column of
its own with a flat prior, which is exact however V couples them (`leave_out`). Where the numbers
are fewer than the columns, only blocks on the diagonal of A and a few of its rows are ever formed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.balance import below
from imucalib.posterior.search.noise import NoiseHypothesis, Terms
from imucalib.posterior.search.problem import Problem

#: Numbers of blocks that are made at once, columns that are weighted, and columns whose products
#: are quicker together than block by block.
_AT_ONCE, _COLUMNS, _SIDE = 1 << 21, 256, 64
#: A block of columns and the sd of its normal prior, times the noise factor; infinite where flat.
Block = tuple[Index, float]


@dataclass(frozen=True)
class Weighted:
    """Of which a row or a block is made when it is asked for: a search asks for each block once.

    columns : (N, q) Z; solves : of each noise what multiplies columns (N, m) by V⁻¹
    known : (k, q) rows of what is known before the readings
    """

    columns: Array
    solves: tuple[Callable[[Array], Array], ...]
    known: Array

    def rows(self, at: Index) -> Array:
        """(E, s, q) some rows."""
        own, known = self.columns[:, at], self.known[:, at].T @ self.known
        return np.array([solve(own).T @ self.columns + known for solve in self.solves])

    @cached_property
    def along(self) -> Array:
        """(E, q) products with y."""
        return np.asarray(self.rows(np.array([self.columns.shape[1] - 1]))[:, 0])

    def blocks(self, index: Index) -> Array:
        """(E, m, w, w) blocks on the diagonal of columns index (m, w)."""
        (m, w), n = index.shape, len(self.columns)
        own, known = np.empty((len(self.solves), m, w, w)), self.known[:, index]
        step = max(1, _AT_ONCE // (len(self.solves) * n * w))
        for a in range(0, m, step):
            left = self.columns[:, index[a : a + step]]
            for k, solve in enumerate(self.solves):
                right = solve(left.reshape(n, -1)).reshape(left.shape)
                np.matmul(left.transpose(1, 2, 0), right.transpose(1, 0, 2), own[k, a : a + step])
        return np.asarray(own + np.einsum("kmw,kmv->mwv", known, known))

    def of(self, noises: Index) -> Weighted:
        """At some of the noises."""
        return replace(self, solves=tuple(self.solves[k] for k in noises))

    def select_columns(self, columns: Index) -> Weighted:
        """Of some columns, in their order."""
        return replace(self, columns=self.columns[:, columns], known=self.known[:, columns])


@dataclass(frozen=True)
class Multiplied:
    """Multiplied out, y last. matrix : (E, q, q)"""

    matrix: Array

    def rows(self, at: Index) -> Array:
        """(E, s, q) some rows."""
        return np.asarray(self.matrix[:, at])

    @property
    def along(self) -> Array:
        """(E, q) products with y."""
        return np.asarray(self.matrix[:, -1])

    def blocks(self, index: Index) -> Array:
        """(E, m, w, w) blocks on the diagonal of columns index (m, w)."""
        return np.asarray(self.matrix[:, index[:, :, None], index[:, None, :]])

    def of(self, noises: Index) -> Multiplied:
        """At some of the noises."""
        return Multiplied(self.matrix[noises])

    def select_columns(self, columns: Index) -> Multiplied:
        """Of some columns, in their order."""
        return Multiplied(self.matrix[:, columns[:, None], columns])


class Whitening(Protocol):
    """L⁻¹ at E noises, L Lᵀ = V."""

    @property
    def noises(self) -> int:
        """E"""
        ...

    def __call__(self, columns: Array) -> Array:
        """(E, n, m) L⁻¹ of columns (n, m)."""
        ...

    def back(self, white: Array) -> Array:
        """(E, n, m) L⁻ᵀ of columns (E, n, m)."""
        ...

    def of(self, noises: Index) -> Whitening:
        """At some of the noises."""
        ...


@dataclass(frozen=True)
class Unmultiplied:
    """`Weighted` of what all noises whiten at once. columns : (n, q) Z"""

    columns: Array
    white: Whitening

    def rows(self, at: Index) -> Array:
        """(E, s, q) some rows."""
        weighted = self.white.back(self.white(self.columns[:, at])).swapaxes(1, 2)
        flat = weighted.reshape(-1, len(self.columns)) @ self.columns
        return np.asarray(flat.reshape(len(weighted), *at.shape, self.columns.shape[1]))

    @cached_property
    def along(self) -> Array:
        """(E, q) products with y."""
        return np.asarray(self.rows(np.array([self.columns.shape[1] - 1]))[:, 0])

    def blocks(self, index: Index) -> Array:
        """(E, m, w, w) blocks on the diagonal of columns index (m, w)."""
        (m, w), made = index.shape, self.white.noises * len(self.columns)
        out = np.empty((self.white.noises, m, w, w))
        step = max(1, min(_AT_ONCE // made, _SIDE) // w)
        for a in range(0, m, step):
            part = index[a : a + step]
            own = self.white(self.columns[:, part.ravel()])
            gram, at = own.swapaxes(1, 2) @ own, np.arange(part.size).reshape(part.shape)
            out[:, a : a + step] = gram[:, at[:, :, None], at[:, None, :]]
        return out

    def of(self, noises: Index) -> Unmultiplied:
        """At some of the noises."""
        return replace(self, white=self.white.of(noises))

    def select_columns(self, columns: Index) -> Multiplied:
        """Of some columns, in their order, which are few enough to be multiplied out."""
        some = self.columns[:, columns]
        found = (self.white.of(np.array([k]))(some)[0] for k in range(self.white.noises))
        return Multiplied(np.array([own.T @ own for own in found]))


#: Zᵀ V⁻¹ Z at E noises.
Products = Weighted | Multiplied | Unmultiplied


@dataclass(frozen=True)
class Grams:
    """products : of all data; removed : (E, t, q) factors of what has been integrated out
    log_weight : (E,) log prior of each noise less half of log |V| and of what was integrated out
    numbers : how many numbers they hold; points : the noises
    spread : sd of the log of the noise factor about 1, infinite where nothing is known of it
    columns : (N, q) Z of the readings' numbers, and inverse : gives of a noise what multiplies
        columns (N, m) by V⁻¹, where numbers are to be left out or freed
    """

    products: Products
    removed: Array
    log_weight: Array
    numbers: float
    points: tuple[Any, ...]
    spread: float
    columns: Array = field(default_factory=lambda: np.zeros((0, 0)))
    inverse: Callable[[Any], Callable[[Array], Array]] | None = None

    @cached_property
    def solves(self) -> tuple[Callable[[Array], Array], ...]:
        """V⁻¹ at each noise. Raises TypeError where it was not kept."""
        if isinstance(self.products, Weighted):
            return self.products.solves
        if self.inverse is None:
            raise TypeError("the products' own numbers were not kept")
        return tuple(self.inverse(point) for point in self.points)

    @cached_property
    def weighted(self) -> Array:
        """(E, N, q) V⁻¹ Z."""
        out = np.empty((len(self.solves), *self.columns.shape))
        for k, solve in enumerate(self.solves):
            for a in range(0, out.shape[2], _COLUMNS):
                out[k, :, a : a + _COLUMNS] = solve(self.columns[:, a : a + _COLUMNS])
        return out

    def log_noise(self, power: Array, dof: float) -> Array:
        """(...) what is left of yᵀ V⁻¹ y with the noise factor integrated out: under Jeffreys'
        prior, and what is known of the factor at its likeliest value."""
        factor = 0.5 * np.log(power / dof)
        return np.asarray(-0.5 * dof * np.log(power) - 0.5 * (factor / self.spread) ** 2)

    def rows(self, at: Index) -> Array:
        """(E, s, q) some rows of A."""
        own = self.removed[:, :, at].transpose(0, 2, 1)
        return np.asarray(self.products.rows(at) - own @ self.removed)

    def blocks(self, index: Index, whole: Array | None = None) -> Array:
        """(E, m, w, w) blocks on its diagonal; whole : those of `products`, where they are there"""
        first = self.products.blocks(index) if whole is None else whole
        own = self.removed[:, :, index].transpose(0, 2, 3, 1)
        return np.asarray(first - own @ own.swapaxes(2, 3))

    @cached_property
    def along(self) -> Array:
        """(E, q) products with y."""
        own = self.removed[:, :, -1:].swapaxes(1, 2) @ self.removed
        return np.asarray(self.products.along - own[:, 0])

    @property
    def power(self) -> Array:
        """(E,) what is left of yᵀ V⁻¹ y."""
        return np.asarray(np.maximum(self.along[:, -1], 1e-9))

    def evidence(self, dof: float) -> float:
        """Log evidence over all noises beside what has been integrated out."""
        return float(log_sum(self.log_weight + self.log_noise(self.power, dof)))

    def of(self, noises: Index) -> Grams:
        """At some of the noises."""
        return replace(
            self,
            products=self.products.of(noises),
            removed=self.removed[noises],
            log_weight=self.log_weight[noises],
            points=tuple(self.points[k] for k in noises),
        )


def select_columns(grams: Grams, columns: Index) -> Grams:
    """Of some of the columns, in ascending order, y among them as the last."""
    return replace(
        grams,
        products=grams.products.select_columns(columns),
        removed=grams.removed[:, :, columns],
        columns=grams.columns[:, columns],
    )


def multiply_columns(
    columns: Array, known: Array, solves: tuple[Callable[[Array], Array], ...]
) -> Products:
    """Of columns (N, q) as in `Weighted`, multiplied out where there are more numbers than
    columns."""
    if len(columns) <= columns.shape[1]:
        return Weighted(columns, solves, known)
    return Multiplied(np.array([columns.T @ v(columns) + known.T @ known for v in solves]))


def grams_of(problem: Problem, terms: Terms, points: Sequence[NoiseHypothesis]) -> Grams:
    """At some noises."""
    n, q = len(terms.order), problem.columns.shape[1]
    columns, known = problem.columns[:n], problem.columns[n:]
    covariances = [terms.covariance(point) for point in points]
    weight = np.array(
        [p.log_prior - 0.5 * v.log_det for p, v in zip(points, covariances, strict=True)]
    )
    prior = problem.fit.observations.noise_prior
    return Grams(
        products=multiply_columns(columns, known, tuple(v.solve for v in covariances)),
        removed=np.zeros((len(points), 0, q)),
        log_weight=weight,
        numbers=problem.numbers,
        points=tuple(points),
        spread=prior.spread if prior else np.inf,
        columns=columns,
        inverse=lambda point: terms.covariance(point).solve,
    )


def leave_out(grams: Grams, problem: Problem, rows: Index) -> Grams:
    """Of the data without some observations, of which nothing is integrated out: A less
    U_Fᵀ ((V⁻¹)_FF)⁻¹ U_F, U = V⁻¹ Z (Cook and Weisberg 1982)."""
    gone = np.flatnonzero(np.isin(problem.owner, rows))
    unit = np.zeros((len(grams.columns), gone.size))
    unit[gone, np.arange(gone.size)] = 1.0
    removed = np.empty((len(grams.points), gone.size, grams.columns.shape[1]))
    log_weight = grams.log_weight.copy()
    for k, solve in enumerate(grams.solves):
        lower = np.linalg.cholesky(solve(unit)[gone])
        removed[k] = below(lower, grams.weighted[k][gone])
        log_weight[k] -= np.log(np.diag(lower)).sum()
    removed = np.concatenate([grams.removed, removed], axis=1)
    return replace(grams, removed=removed, log_weight=log_weight, numbers=grams.numbers - gone.size)


def marginalize(grams: Grams, *blocks: Block) -> Grams:
    """With blocks of columns integrated out, one after the other."""
    for columns, size in blocks:
        rows = grams.rows(columns)
        inner, log_size = rows[:, :, columns], 0.0
        if np.isfinite(size):
            inner = inner + np.eye(columns.size) / size**2
            log_size = columns.size * float(np.log(size))
        lower = np.linalg.cholesky(inner)
        diagonal = np.diagonal(lower, axis1=1, axis2=2)
        grams = replace(
            grams,
            removed=np.concatenate([grams.removed, np.linalg.solve(lower, rows)], axis=1),
            log_weight=grams.log_weight - np.log(diagonal).sum(axis=1) - log_size,
        )
    return grams


def log_sum(logs: Array) -> Array:
    """Log of the sum of exponentials over the first axis, ten times as quick as `logaddexp`; -inf
    where there is nothing."""
    top = logs.max(axis=0)
    safe = np.where(np.isfinite(top), top, 0.0)
    with np.errstate(divide="ignore"):
        return np.asarray(safe + np.log(np.exp(logs - safe).sum(axis=0)))
