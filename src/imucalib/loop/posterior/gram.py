"""Products of the problem's columns at every noise: all that the search, folds and words ever see.

    A = Zᵀ V⁻¹ Z - Σ Xᵀ X,  Z = [base | members | y]

What is taken out leaves as factors X: a block of columns S with a normal prior of size τ as
L⁻¹ A_S, L Lᵀ = A_SS + 1/τ² (`swept`). Numbers that are left out are free, each by a column of its
own with a flat prior, which is exact however V couples them (`without`). Where the numbers are
fewer than the columns, only blocks on the diagonal of A and a few of its rows are ever formed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.balance import below
from imucalib.effects.record_error import GROSS_MG
from imucalib.loop.posterior.noise import Point, Terms
from imucalib.loop.posterior.odds import AXES, GROSS, HEARD, REACH, SIZES, UNEVEN
from imucalib.loop.posterior.problem import Problem
from imucalib.units import MG

#: Rows whose own precision is formed at once.
_AT_ONCE = 64


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

    def narrowed(self, columns: Index) -> Products:
        """Of some columns, in their order."""


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

    def narrowed(self, columns: Index) -> Multiplied:
        """Of some columns, in their order."""
        return Multiplied(self.matrix[:, columns[:, None], columns])


@dataclass(frozen=True)
class Source:
    """What products were made of, which gives those without some numbers.

    columns : (N, q) Z of the readings' numbers; points : the noises
    inverse : gives what multiplies columns (N, m) by V⁻¹ at a noise
    """

    columns: Array
    points: tuple[Any, ...]
    inverse: Callable[[Any], Callable[[Array], Array]]

    @cached_property
    def solves(self) -> tuple[Callable[[Array], Array], ...]:
        """V⁻¹ at each noise."""
        return tuple(self.inverse(point) for point in self.points)

    @cached_property
    def weighted(self) -> tuple[Array, ...]:
        """(N, q) V⁻¹ Z at each noise."""
        return tuple(solve(self.columns) for solve in self.solves)


@dataclass(frozen=True)
class Grams:
    """products : of all data; taken : (E, t, q) what has been taken out
    log_weight : (E,) log prior of each noise less half of log |V| and what was taken
    numbers : how many numbers they hold; points : the noises
    spread : sd of the log of the noise factor about 1, infinite where nothing is known of it
    source : what they were made of, where numbers are to be left out or freed
    """

    products: Products
    taken: Array
    log_weight: Array
    numbers: float
    points: tuple[object, ...]
    spread: float
    source: Source | None = None

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
        points = tuple(self.points[k] for k in noises)
        return replace(
            self,
            products=self.products.of(noises),
            taken=self.taken[noises],
            log_weight=self.log_weight[noises],
            points=points,
            source=replace(self.source, points=points) if self.source else None,
        )


def narrowed(grams: Grams, columns: Index) -> Grams:
    """Of some of the columns, in ascending order, y among them as the last."""
    source = source_of(grams)
    return replace(
        grams,
        products=grams.products.narrowed(columns),
        taken=grams.taken[:, :, columns],
        source=replace(source, columns=source.columns[:, columns]),
    )


def source_of(grams: Grams) -> Source:
    """What Grams were made of. Raises TypeError where that was not kept."""
    if grams.source is None:
        raise TypeError("nothing is known of the numbers of these products")
    return grams.source


def freed(grams: Grams, problem: Problem, columns: Index) -> Grams:
    """Multiplied out beside the base model: of some columns, of one column for each number of a
    reading by itself, and y. A number that is free is as good as one that is not there."""
    source, p = source_of(grams), problem.base
    n, last = len(source.columns), problem.columns.shape[1] - 1
    own = np.concatenate([np.arange(p), columns])
    every = np.column_stack([source.columns[:, own], np.eye(n), source.columns[:, last]])
    known = np.zeros((len(problem.columns) - n, every.shape[1]))
    known[:, : own.size], known[:, -1] = problem.columns[n:, own], problem.columns[n:, last]
    matrix = np.array([every.T @ solve(every) for solve in source.solves]) + known.T @ known
    nothing = np.zeros((len(matrix), 0, every.shape[1]))
    whole = replace(grams, products=Multiplied(matrix), taken=nothing, source=None)
    rest = swept(whole, *problem.flat)
    beside_base = rest.rows(np.arange(p, every.shape[1]))[:, :, p:]
    return replace(rest, products=Multiplied(beside_base), taken=nothing[:, :, p:])


def grams_of(problem: Problem, terms: Terms) -> Grams:
    """At all noises that the data do not exclude, be the base complete or lack every free function
    at once, with gross errors: what a model lacks looks like noise, and what it holds does not."""
    n, q = len(terms.order), problem.columns.shape[1]
    found = np.zeros(len(terms.points), bool)
    for lacked in (np.zeros((n, 0)), np.hstack([_rich(problem, n), _gross(problem, terms)])):
        evidence = _evidence(problem, terms, terms.points, lacked)
        found |= evidence > evidence.max() - HEARD
    kept = tuple(terms.points[k] for k in np.flatnonzero(found))
    columns, known = problem.columns[:n], problem.columns[n:]
    few = n <= q
    out = np.empty((len(kept), n if few else q, q))
    weight = np.empty(len(kept))
    for k, point in enumerate(kept):
        covariance = terms.covariance(point)
        weighted = covariance.solve(columns)
        out[k] = weighted if few else columns.T @ weighted + known.T @ known
        weight[k] = point.log_prior - 0.5 * covariance.log_det
    products = Weighted(columns, out, known) if few else Multiplied(out)
    return Grams(
        products=products,
        taken=np.zeros((len(kept), 0, q)),
        log_weight=weight,
        numbers=problem.numbers,
        points=kept,
        spread=_spread(problem),
        source=Source(columns, kept, lambda point: terms.covariance(point).solve),
    )


def axis_noise(problem: Problem, terms: Terms) -> Array:
    """(K, 3) likeliest standard deviations of the axes' noise beside each other, in steps, be the
    base complete or lack every free function at once or any one of them, however large, with gross
    errors: neither an effect on one axis nor a wrong record is its noise."""
    rare = float(np.log(UNEVEN / (1.0 - UNEVEN) / len(AXES)))
    still = [p for p in terms.points if p.walk is None]
    best, power = -np.inf, np.ones(terms.axes.shape[1])
    gross = _gross(problem, terms)
    every = np.hstack([gross, _rich(problem, len(terms.order))])
    plain = _evidence(problem, terms, still, gross)
    alone = np.hstack([gross, _alone(problem, terms, gross, still[int(plain.argmax())])])
    for lacked in (gross, every, alone):
        logs = plain if lacked is gross else _evidence(problem, terms, still, lacked)
        own, reached, point = np.ones(power.size), float(logs.max()), still[int(logs.argmax())]
        for axis in np.argsort(-_misfit(problem, terms)):
            for step in AXES:
                trial = own.copy()
                trial[axis] = step**2
                relative = trial / np.exp(np.log(trial).mean())  # all of them are the one factor
                evidence = float(_evidence(problem, terms, [point], lacked, relative)[0])
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


def _rich(problem: Problem, n: int) -> Array:
    """(N, m) factor of every free function that the base may lack."""
    free = [c.at for c in problem.choices if problem.components[c.component].kind == "free"]
    return REACH * problem.columns[:n, np.unique(np.concatenate([np.zeros(0, np.intp), *free]))]


def _alone(problem: Problem, terms: Terms, gross: Array, point: Point) -> Array:
    """(N, m) factor of the one free function, at its size, beside which the base is likeliest at
    a noise."""
    n = len(terms.order)
    best, found = -np.inf, np.zeros((n, 0))
    for choice in problem.choices:
        if problem.components[choice.component].kind != "free":
            continue
        for size in (REACH, float(SIZES[-1])):
            factor = size * problem.columns[:n, choice.at]
            one = _evidence(problem, terms, [point], np.hstack([gross, factor]))[0]
            if one > best:
                best, found = float(one), factor
    return found


def _spread(problem: Problem) -> float:
    prior = problem.fit.observations.noise_prior
    return prior.spread if prior else np.inf


def _gross(problem: Problem, terms: Terms) -> Array:
    """(N, m) factor of gross errors of the records, and of the setting of each dial, that belong
    least to the others."""
    fit, n = problem.fit, len(terms.order)
    white, basis = fit.white_basis()

    def beside_base(columns: Array) -> Array:
        own = white(columns)
        return np.asarray(own - basis @ (basis.T @ own))

    rest = beside_base(fit.at.residual[:, None])[:, 0]
    pulled = white.back(rest[:, None])[:, 0]
    size, numbers = np.empty(fit.observations.n), list[Index]()
    for some in np.array_split(np.arange(size.size), -(-size.size // _AT_ONCE)):
        rows = [np.flatnonzero(terms.order == row) for row in some]
        every, first = np.concatenate(rows), np.cumsum([0, *(r.size for r in rows)])
        own = np.zeros((n, every.size))
        own[every, np.arange(every.size)] = 1.0
        own = beside_base(own)
        for k, row in enumerate(some):
            block = own[:, first[k] : first[k + 1]]
            inner = block.T @ block + 1e-9 * np.eye(rows[k].size)
            size[row] = pulled[rows[k]] @ np.linalg.solve(inner, pulled[rows[k]])
        numbers += rows
    unit = GROSS_MG * MG / fit.at.unit
    factors = []
    for row in np.argsort(size)[-GROSS:]:
        one = np.zeros((n, numbers[row].size))
        one[numbers[row], np.arange(numbers[row].size)] = unit[numbers[row]]
        factors.append(one)
    for settings in fit.at.settings[: fit.at.free]:
        power = np.sum(beside_base(settings) ** 2, axis=0)
        worst = int(np.argmax((settings.T @ pulled) ** 2 / (power + 1e-9)))
        factors.append(settings[:, worst : worst + 1])
    return np.hstack(factors)


def _evidence(
    problem: Problem,
    terms: Terms,
    points: Sequence[Point],
    lacked: Array,
    power: Array | None = None,
) -> Array:
    """(P,) log evidence of the base model, as in `Terms.evidence`."""
    n = len(terms.order)
    brief = problem.columns[:, [*range(problem.base), problem.columns.shape[1] - 1]]
    return terms.evidence(
        points,
        brief[:n],
        brief[n:],
        problem.numbers - problem.base,
        lacked,
        np.ones(terms.axes.shape[1]) if power is None else power,
    )


def without(grams: Grams, problem: Problem, rows: Index) -> Grams:
    """Of the data without some observations, of which nothing is taken out: A less
    U_Fᵀ ((V⁻¹)_FF)⁻¹ U_F, U = V⁻¹ Z (Cook and Weisberg 1982)."""
    source = source_of(grams)
    left = np.flatnonzero(np.isin(problem.owner, rows))
    unit = np.zeros((len(source.columns), left.size))
    unit[left, np.arange(left.size)] = 1.0
    taken = np.empty((len(source.points), left.size, source.columns.shape[1]))
    log_weight = grams.log_weight.copy()
    for k, solve in enumerate(source.solves):
        lower = np.linalg.cholesky(solve(unit)[left])
        taken[k] = below(lower, source.weighted[k][left])
        log_weight[k] -= np.log(np.diag(lower)).sum()
    taken = np.concatenate([grams.taken, taken], axis=1)
    return replace(grams, taken=taken, log_weight=log_weight, numbers=grams.numbers - left.size)


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
