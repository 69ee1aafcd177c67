"""What a model is worth on blocks of time that it was not fitted to.

The log density of block k given the others, parameters integrated, is a difference of two totals
of small matrices (P, Q as in `likelihood`, A: all, T: without block k and its gap):

    l_k = -1/2 [log|V_k| + log|P_A| - log|P_T| + (Q_A - Q_T) / s² + n_k log s²]

It is marginal: the walk is not continued from the neighbours.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from imucalib.arrays import Array
from imucalib.loop.wander.bank import Bank, Mask, Split
from imucalib.loop.wander.likelihood import Terms, sizes, solutions


@dataclass(frozen=True)
class Judged:
    """Of every block (k,): log density, and how to make the mean size of the error, in units of
    the columns, which a density that has not gained asks nobody for."""

    nats: Array
    error: Callable[[], Array]
    count: Array

    @cached_property
    def mean_error(self) -> float:
        return float(np.sum(self.error() * self.count) / np.sum(self.count))


def inside(splits: Sequence[Split], keep: Mask) -> tuple[Split, ...]:
    """The design on a part of the data."""
    cut = [Split(s.test & keep, s.train & keep) for s in splits]
    return tuple(s for s in cut if s.test.any() and s.train.any())


def solved(bank: Bank, terms: Terms, walk: int, keep: Mask) -> Array:
    """(p,) the parameters from the parts that are kept, in units of the columns."""
    gram = bank.by_part(walk, np.append(terms.columns, bank.data))[keep].sum(axis=0)
    return np.asarray(solutions(gram[None], terms.precision)[0])


def judged(bank: Bank, terms: Terms, walk: int, splits: Sequence[Split]) -> Judged:
    """Every block of the design predicted by the model fitted without it."""
    return judged_each(bank, [terms], walk, splits)[0]


def judged_each(
    bank: Bank, models: Sequence[Terms], walk: int, splits: Sequence[Split]
) -> list[Judged]:
    """The same of models of the same columns under other priors."""
    at = np.append(models[0].columns, bank.data)
    parts = bank.by_part(walk, at)
    train, test = (np.array([getattr(s, name) for s in splits]) for name in ("train", "test"))
    some, every = _summed(train, parts), _summed(train | test, parts)
    n, trained = test @ bank.count, train @ bank.count
    log_v, rows = test @ bank.log_det[walk], test.T[bank.course.part]

    def one(terms: Terms) -> Judged:
        p_train, q_train = sizes(some, terms.precision)
        p_all, q_all = sizes(every, terms.precision)
        s2 = np.maximum(q_train / np.maximum(trained - terms.base, 1), 1e-300)
        nats = -0.5 * (log_v + p_all - p_train + (q_all - q_train) / s2 + n * np.log(s2))

        def error() -> Array:
            theta = solutions(some, terms.precision)
            left = bank.columns[:, at] @ np.column_stack([-theta, np.ones(len(theta))]).T
            return np.asarray((np.abs(left) * rows).sum(axis=0) / n)

        return Judged(nats, error, n.astype(float))

    return [one(terms) for terms in models]


def _summed(masks: Mask, parts: Array) -> Array:
    """(k, c, c) products (parts, c, c) over each mask's parts."""
    flat = masks.astype(np.float64) @ parts.reshape(len(parts), -1)
    return np.asarray(flat.reshape(-1, *parts.shape[1:]))
