"""What a model is worth on blocks of time that it was not fitted to.

The log density of block k given the others, parameters integrated, is a difference of two totals
of small matrices (P, Q as in `likelihood`, A: all, T: without block k and its gap):

    l_k = -1/2 [log|V_k| + log|P_A| - log|P_T| + (Q_A - Q_T) / s² + n_k log s²]

It is marginal: the walk is not continued from the neighbours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.loop.wander.bank import Bank, Mask, Split
from imucalib.loop.wander.likelihood import Terms


@dataclass(frozen=True)
class Judged:
    """Of every block (k,): log density, and mean size of the error in units of the columns."""

    nats: Array
    error: Array
    count: Array

    @property
    def mean_error(self) -> float:
        return float(np.sum(self.error * self.count) / np.sum(self.count))


def inside(splits: Sequence[Split], keep: Mask) -> tuple[Split, ...]:
    """The design on a part of the data."""
    cut = [Split(s.test & keep, s.train & keep) for s in splits]
    return tuple(s for s in cut if s.test.any() and s.train.any())


def solved(bank: Bank, terms: Terms, walk: int, keep: Mask) -> Array:
    """(p,) the parameters from the parts that are kept, in units of the columns."""
    gram = bank.by_part(walk, np.append(terms.columns, bank.data))[keep].sum(axis=0)
    precise = gram[:-1, :-1] + np.diag(terms.precision)
    return np.asarray(np.linalg.solve(precise, gram[:-1, -1]))


def judged(bank: Bank, terms: Terms, walk: int, splits: Sequence[Split]) -> Judged:
    """Every block of the design predicted by the model fitted without it."""
    parts = bank.by_part(walk, np.append(terms.columns, bank.data))
    nats, error, count = [], [], []
    for split in splits:
        fitted, both = parts[split.train].sum(axis=0), parts[split.train | split.test].sum(axis=0)
        p_train, q_train, theta = _balance(fitted, terms.precision)
        p_all, q_all, _ = _balance(both, terms.precision)
        n = int(bank.count[split.test].sum())
        s2 = max(q_train / max(int(bank.count[split.train].sum()) - terms.base, 1), 1e-300)
        log_v = float(bank.log_det[walk, split.test].sum())
        nats.append(-0.5 * (log_v + p_all - p_train + (q_all - q_train) / s2 + n * np.log(s2)))
        rows = split.test[bank.course.part]
        left = bank.columns[rows, bank.data] - bank.columns[np.ix_(rows, terms.columns)] @ theta
        error.append(np.mean(np.abs(left)))
        count.append(n)
    return Judged(np.array(nats), np.array(error), np.array(count, dtype=float))


def _balance(gram: Array, precision: Array) -> tuple[float, float, Array]:
    precise = gram[:-1, :-1] + np.diag(precision)
    theta = np.asarray(np.linalg.solve(precise, gram[:-1, -1]), np.float64)
    return float(np.linalg.slogdet(precise)[1]), float(gram[-1, -1] - gram[-1, :-1] @ theta), theta
