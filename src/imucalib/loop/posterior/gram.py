"""Products of the problem's columns at every noise: all that the search, folds and words ever see.

    A = Zᵀ V⁻¹ Z - Σ Xᵀ X,  Z = [base | members | y]

What is taken out leaves as factors X: a block of columns S with a normal prior of size τ as
L⁻¹ A_S, L Lᵀ = A_SS + 1/τ² (`swept`). Numbers that are left out are free, each by a column of its
own with a flat prior, which is exact however V couples them (`without`). Only blocks on the
diagonal of A and a few of its rows are ever formed.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.effects.record_error import GROSS_MG
from imucalib.loop.posterior.noise import Point, Terms
from imucalib.loop.posterior.odds import AXES, GROSS, HEARD, REACH, UNEVEN
from imucalib.loop.posterior.problem import Problem
from imucalib.units import MG


class Products(Protocol):
    """Zᵀ V⁻¹ Z at E noises, however V is taken off."""

    def rows(self, at: Index) -> Array:
        """(E, s, q) some rows."""

    @property
    def along(self) -> Array:
        """(E, q) products with y."""

    def blocks(self, index: Index) -> Array:
        """(E, m, w, w) blocks on the diagonal of columns index (m, w)."""

    def of(self, noises: Index) -> Products:
        """At some of the noises."""


@runtime_checkable
class Separable(Products, Protocol):
    """Products that know of which observations they are."""

    def narrowed(self, columns: Index) -> Separable:
        """Of some columns, in their order."""

    def without(self, grams: Grams, problem: Problem, rows: Index) -> Grams:
        """`grams`, of which nothing is taken out, of the data without some observations."""


@dataclass(frozen=True)
class Weighted:
    """columns : (N, q) Z; weighted : (E, N, q) V⁻¹ Z; known : (k, q) rows of what is known before
    the readings"""

    columns: Array
    weighted: Array
    known: Array

    def rows(self, at: Index) -> Array:
        """(E, s, q) some rows."""
        found = self.columns[:, at].T @ self.weighted
        return np.asarray(found + self.known[:, at].T @ self.known)

    @cached_property
    def along(self) -> Array:
        """(E, q) products with y."""
        return np.asarray(self.rows(np.array([self.columns.shape[1] - 1]))[:, 0])

    def blocks(self, index: Index) -> Array:
        """(E, m, w, w) blocks on the diagonal of columns index (m, w)."""
        left, right = self.columns[:, index], self.weighted[:, :, index]
        own = np.matmul(left.transpose(1, 2, 0)[None], right.transpose(0, 2, 1, 3))
        known = self.known[:, index]
        return np.asarray(own + np.einsum("kmw,kmv->mwv", known, known))

    def of(self, noises: Index) -> Weighted:
        """At some of the noises."""
        return replace(self, weighted=self.weighted[noises])

    def narrowed(self, columns: Index) -> Weighted:
        """Of some columns, in their order."""
        return Weighted(
            self.columns[:, columns], self.weighted[:, :, columns], self.known[:, columns]
        )

    def without(self, grams: Grams, problem: Problem, rows: Index) -> Grams:
        """Without some observations: each number's own column is free."""
        columns = problem.of_rows(rows)
        return replace(swept(grams, columns, np.inf), numbers=grams.numbers - columns.size)


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


@dataclass(frozen=True)
class Grams:
    """products : of all data; taken : (E, t, q) what has been taken out
    log_weight : (E,) log prior of each noise less half of log |V| and what was taken
    numbers : how many numbers they hold; points : the noises
    spread : sd of the log of the noise factor about 1, infinite where nothing is known of it
    """

    products: Products
    taken: Array
    log_weight: Array
    numbers: float
    points: tuple[object, ...]
    spread: float

    def log_noise(self, power: Array, dof: float) -> Array:
        """(...) what is left of yᵀ V⁻¹ y with the noise factor integrated out: under Jeffreys'
        prior, and what is known of the factor at its likeliest value."""
        factor = 0.5 * np.log(power / dof)
        return np.asarray(-0.5 * dof * np.log(power) - 0.5 * (factor / self.spread) ** 2)

    def rows(self, at: Index) -> Array:
        """(E, s, q) some rows of A."""
        own = self.taken[:, :, at].transpose(0, 2, 1)
        return np.asarray(self.products.rows(at) - own @ self.taken)

    def blocks(self, index: Index, whole: Array | None = None) -> Array:
        """(E, m, w, w) blocks on its diagonal; whole : those of `products`, where they are there"""
        first = self.products.blocks(index) if whole is None else whole
        own = self.taken[:, :, index].transpose(0, 2, 3, 1)
        return np.asarray(first - own @ own.swapaxes(2, 3))

    @cached_property
    def along(self) -> Array:
        """(E, q) products with y."""
        own = self.taken[:, :, -1:].swapaxes(1, 2) @ self.taken
        return np.asarray(self.products.along - own[:, 0])

    @property
    def power(self) -> Array:
        """(E,) what is left of yᵀ V⁻¹ y."""
        return np.asarray(np.maximum(self.along[:, -1], 1e-9))

    def evidence(self, dof: float) -> float:
        """Log evidence over all noises of what has been taken out."""
        return float(log_sum(self.log_weight + self.log_noise(self.power, dof)))

    def of(self, noises: Index) -> Grams:
        """At some of the noises."""
        return Grams(
            products=self.products.of(noises),
            taken=self.taken[noises],
            log_weight=self.log_weight[noises],
            numbers=self.numbers,
            points=tuple(self.points[k] for k in noises),
            spread=self.spread,
        )


def narrowed(grams: Grams, columns: Index) -> Grams:
    """Of some of the columns, in ascending order, y among them as the last."""
    products = separable(grams).narrowed(columns)
    return replace(grams, products=products, taken=grams.taken[:, :, columns])


def restricted(grams: Grams, columns: Index) -> Grams:
    """The same multiplied out: of few columns that much is asked of."""
    own = narrowed(grams, columns).rows(np.arange(columns.size))
    return replace(grams, products=Multiplied(own), taken=np.zeros((len(own), 0, columns.size)))


def grams_of(problem: Problem, terms: Terms) -> Grams:
    """At all noises that the data do not exclude, be the base complete or lack every free function
    at once, with gross errors: what a model lacks looks like noise, and what it holds does not."""
    n = len(terms.order)
    found = np.zeros(len(terms.points), bool)
    for lacked in (0.0, _rich(problem, terms) + _gross(problem, terms)):
        evidence = np.array([_evidence(problem, terms, p, lacked) for p in terms.points])
        found |= evidence > evidence.max() - HEARD
    kept = tuple(terms.points[k] for k in np.flatnonzero(found))
    weighted = np.empty((len(kept), n, problem.columns.shape[1]))
    weight = np.empty(len(kept))
    for k, point in enumerate(kept):
        lower = _cholesky(terms.covariance(point))
        weighted[k] = _both(lower, problem.columns[:n])
        weight[k] = point.log_prior - float(np.log(np.diag(lower)).sum())
    products = Weighted(problem.columns[:n], weighted, problem.columns[n:])
    nothing = np.zeros((len(kept), 0, problem.columns.shape[1]))
    return Grams(products, nothing, weight, problem.numbers, kept, _spread(problem))


def axis_noise(problem: Problem, terms: Terms) -> Array:
    """(K, 3) likeliest standard deviations of the axes' noise beside each other, in steps, be the
    base complete or lack every free function at once, with gross errors: neither an effect on one
    axis nor a wrong record is its noise."""
    rare = float(np.log(UNEVEN / (1.0 - UNEVEN) / len(AXES)))
    still = [p for p in terms.points if p.walk is None and not p.sharing]
    best, power = -np.inf, np.ones(terms.axes.shape[1])
    gross = _gross(problem, terms)
    for lacked in (gross, gross + _rich(problem, terms)):
        point = max(still, key=lambda p: _evidence(problem, terms, p, lacked))
        own = np.ones(terms.axes.shape[1])
        reached = _evidence(problem, terms, point, lacked)
        for axis in np.argsort(-_misfit(problem, terms)):
            for step in AXES:
                trial = own.copy()
                trial[axis] = step**2
                evidence = _evidence(problem, terms, point, lacked, trial)
                evidence += rare * np.count_nonzero(trial != 1.0)
                if evidence > reached:
                    reached, own = evidence, trial
        if reached > best:
            best, power = reached, own
    return np.asarray(np.sqrt(power).reshape(-1, 3))


def _misfit(problem: Problem, terms: Terms) -> Array:
    """(K 3,) mean square of what the base leaves, by axis."""
    left = problem.columns[: len(terms.order), -1]
    return np.asarray(left**2 @ terms.axes / np.maximum(terms.axes.sum(axis=0), 1e-12))


def _rich(problem: Problem, terms: Terms) -> Array:
    """(N, N) covariance of every free function that the base may lack."""
    n = len(terms.order)
    free = [c.at for c in problem.choices if problem.components[c.component].kind == "free"]
    rich = problem.columns[:n, np.concatenate(free)] if free else np.zeros((n, 0))
    return np.asarray(REACH**2 * rich @ rich.T)


def _spread(problem: Problem) -> float:
    prior = problem.fit.observations.noise_prior
    return prior.spread if prior else np.inf


def _gross(problem: Problem, terms: Terms) -> Array:
    """Covariance of gross errors of the records, and of the setting of each dial, that belong least
    to the others."""
    fit, n = problem.fit, len(terms.order)
    white, basis = fit.white_basis()
    root = white(np.eye(n))
    root = root - basis @ (basis.T @ root)
    precision = root.T @ root
    pulled = root.T @ white(fit.at.residual)
    unit = GROSS_MG * MG / fit.at.unit
    whole = np.zeros((n, n))
    rows = [np.flatnonzero(terms.order == row) for row in range(fit.observations.n)]
    size = []
    for own in rows:
        inner = precision[np.ix_(own, own)] + 1e-9 * np.eye(own.size)
        size.append(pulled[own] @ np.linalg.solve(inner, pulled[own]))
    for row in np.argsort(size)[-GROSS:]:
        whole[rows[row], rows[row]] += unit[rows[row]] ** 2
    for settings in fit.at.settings[: fit.at.free]:
        power = np.einsum("nk,nm,mk->k", settings, precision, settings, optimize=True)
        worst = int(np.argmax((settings.T @ pulled) ** 2 / (power + 1e-9)))
        whole += np.outer(settings[:, worst], settings[:, worst])
    return whole


def _evidence(
    problem: Problem, terms: Terms, point: Point, lacked: Array | float, power: Array | float = 1.0
) -> float:
    """Log evidence of the base model at one noise, beside a covariance of what it may lack; power :
    as in `Terms.covariance`"""
    n, dof = len(terms.order), problem.numbers - problem.base
    brief = problem.columns[:, [*range(problem.base), problem.columns.shape[1] - 1]]
    lower = _cholesky(terms.covariance(point, power) + lacked)
    white = np.vstack([_solved(lower, brief[:n]), brief[n:]])
    r = np.linalg.qr(white, mode="r")
    size = np.maximum(np.abs(np.diag(r)), 1e-12)
    logs = np.log(np.diag(lower)).sum() + np.log(size[:-1]).sum() + dof * np.log(size[-1])
    return float(point.log_prior - logs)


def _cholesky(covariance: Array) -> Array:
    return np.asarray(np.linalg.cholesky(covariance))


def _solved(lower: Array, columns: Array) -> Array:
    from scipy.linalg import solve_triangular

    return np.asarray(solve_triangular(lower, columns, lower=True, check_finite=False))


def _both(lower: Array, columns: Array) -> Array:
    from scipy.linalg import cho_solve

    return np.asarray(cho_solve((lower, True), columns, check_finite=False))


def without(grams: Grams, problem: Problem, rows: Index) -> Grams:
    """Of the data without some observations."""
    return separable(grams).without(grams, problem, rows)


def separable(grams: Grams) -> Separable:
    """The products of Grams, whose observations are known. Raises TypeError where they are not."""
    if not isinstance(grams.products, Separable):
        raise TypeError("these products have been multiplied out")
    return grams.products


def swept(grams: Grams, columns: Index, size: float) -> Grams:
    """With a block of columns integrated out under a normal prior of sd `size` times the noise
    factor; infinite where it is flat."""
    rows = grams.rows(columns)
    inner = rows[:, :, columns]
    log_size = 0.0
    if np.isfinite(size):
        inner = inner + np.eye(columns.size) / size**2
        log_size = columns.size * float(np.log(size))
    lower = np.linalg.cholesky(inner)
    diagonal = np.diagonal(lower, axis1=1, axis2=2)
    return replace(
        grams,
        taken=np.concatenate([grams.taken, np.linalg.solve(lower, rows)], axis=1),
        log_weight=grams.log_weight - np.log(diagonal).sum(axis=1) - log_size,
    )


def beside(grams: Grams, blocks: Iterable[tuple[Index, float]]) -> Grams:
    """With blocks of columns of given sizes integrated out, one after the other."""
    for columns, size in blocks:
        grams = swept(grams, columns, size)
    return grams


def log_sum(logs: Array) -> Array:
    """Log of the sum of exponentials over the first axis; -inf where there is nothing."""
    top = logs.max(axis=0)
    safe = np.where(np.isfinite(top), top, 0.0)
    with np.errstate(divide="ignore"):
        return np.asarray(safe + np.log(np.exp(logs - safe).sum(axis=0)))
