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
from imucalib.loop.wander.likelihood import Terms, sizes, totals


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
    return np.asarray(totals(gram[None], terms.precision)[2][0])


def judged(bank: Bank, terms: Terms, walk: int, splits: Sequence[Split]) -> Judged:
    """Every block of the design predicted by the model fitted without it."""
    parts = bank.by_part(walk, np.append(terms.columns, bank.data))
    train, test = (np.array([getattr(s, name) for s in splits]) for name in ("train", "test"))
    p_train, q_train, theta = totals(_summed(train, parts), terms.precision)
    p_all, q_all = sizes(_summed(train | test, parts), terms.precision)
    n, trained = test @ bank.count, train @ bank.count
    s2 = np.maximum(q_train / np.maximum(trained - terms.base, 1), 1e-300)
    log_v = test @ bank.log_det[walk]
    nats = -0.5 * (log_v + p_all - p_train + (q_all - q_train) / s2 + n * np.log(s2))
    left = bank.columns[:, [bank.data]] - bank.columns[:, terms.columns] @ theta.T
    rows = test.T[bank.course.part]
    return Judged(nats, (np.abs(left) * rows).sum(axis=0) / n, n.astype(float))


def _summed(masks: Mask, parts: Array) -> Array:
    """(k, c, c) products (parts, c, c) over each mask's parts."""
    flat = masks.astype(np.float64) @ parts.reshape(len(parts), -1)
    return np.asarray(flat.reshape(-1, *parts.shape[1:]))
