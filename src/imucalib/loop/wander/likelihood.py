"""The restricted likelihood of a model under each noise, s² in closed form.

    L = -1/2 [log|V| + log|P| - log|Λ| + ν log(Q / ν)],  P = X'V⁻¹X + Λ,  Q = y'V⁻¹y - b'P⁻¹b,

b = X'V⁻¹y; Λ the precision of the normal priors of the parameters, ν = n - p of the base
(Patterson and Thompson 1971; Rasmussen and Williams 2006, 2.7).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.loop.wander.bank import Bank, Mask


@dataclass(frozen=True)
class Terms:
    """What is in a model: columns (p,) of the bank, and their prior precisions (p,); base : how
    many of them are the base model's."""

    columns: Index
    precision: Array
    base: int

    def plus(self, columns: Index, size: float) -> Terms:
        """With one more block whose parameters have this size in units of the typical one."""
        extra = np.full(columns.size, size**-2.0)
        return Terms(
            np.concatenate([self.columns, columns]),
            np.concatenate([self.precision, extra]),
            self.base,
        )


@dataclass(frozen=True)
class Level:
    """One walk's index in the bank, the likelihood there, and s² with its freedom."""

    walk: int
    nats: float
    variance: float
    freedom: int


def levels(bank: Bank, terms: Terms, keep: Mask) -> tuple[Level, ...]:
    """The likelihood under every walk, over the parts that are kept."""
    columns = np.append(terms.columns, bank.data)
    freedom = int(bank.count[keep].sum()) - terms.base
    log_p, rest = sizes(bank.products(columns, keep), terms.precision)
    variance = np.maximum(rest, 1e-300) / freedom
    volume = log_p - np.log(terms.precision).sum() + bank.log_det[:, keep].sum(axis=1)
    nats = -0.5 * (volume + freedom * np.log(variance))
    return tuple(Level(k, float(nats[k]), float(variance[k]), freedom) for k in range(len(nats)))


def solutions(gram: Array, precision: Array) -> Array:
    """(k, p) the parameters P⁻¹b of `sizes`."""
    precise = gram[:, :-1, :-1] + np.diag(precision)
    return np.asarray(np.linalg.solve(precise, gram[:, :-1, -1:])[..., 0], np.float64)


def sizes(gram: Array, precision: Array) -> tuple[Array, Array]:
    """log|P| (k,) and Q (k,) of products (k, p + 1, p + 1), the data last, under priors of these
    precisions (p,): one Cholesky factor of P with b below it, whose last row is then L⁻¹b."""
    bordered = gram + np.diag(np.append(precision, 0.0))
    power = gram[:, -1, -1]
    bordered[:, -1, -1] = 2.0 * power + 1e-300  # any number above b'P⁻¹b serves
    root = np.linalg.cholesky(bordered)
    log_p = 2.0 * np.log(np.diagonal(root, axis1=1, axis2=2)[:, :-1]).sum(axis=1)
    return log_p, power - np.sum(root[:, -1, :-1] ** 2, axis=1)


def best_level(bank: Bank, terms: Terms, keep: Mask) -> Level:
    return max(levels(bank, terms, keep), key=lambda level: level.nats)
