"""What a recording says of an effect and of all that would do as well, as products of columns.

Columns are in units of the noise and at typical sizes: the base model's first, then each rival's.
Whatever is recorded next adds its own products, so that a plan is judged without the recording.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.eigen import eigen

#: Sizes of a candidate, in its typical size, over which the evidence is maximised.
TAU = np.array([0.1, 0.3, 1.0, 3.0, 10.0])

#: Precision of a base parameter at typical size that no data determine: a hundred typical sizes.
_OPEN = 1e-4
#: Of a sum of squares in double precision, a unit each.
_ROUNDING = 1e2 * float(np.finfo(float).eps)


@dataclass(frozen=True)
class Products:
    """gram : (P, P) of all columns; along : (P,) with the data; power : of the data; numbers : how
    many they are"""

    gram: Array
    along: Array
    power: float
    numbers: float


@dataclass(frozen=True)
class Ambiguity:
    """An effect that was taken, and those that the data cannot tell from it.

    effect : its name; base : effects of the model without it; columns : (P,) parameters in order,
    the base's first; rivals : names that the data cannot tell apart, the effect itself first
    blocks : name -> columns, of the rivals and of others that must not become such; nats : name ->
    evidence as it was found; dof : degrees of freedom behind the size of the noise
    """

    effect: str
    base: tuple[str, ...]
    columns: tuple[str, ...]
    rivals: tuple[str, ...]
    blocks: Mapping[str, Index]
    nats: Mapping[str, float]
    products: Products
    dof: float

    @property
    def first(self) -> int:
        """Columns of the base model."""
        return int(min(at[0] for at in self.blocks.values()))

    @property
    def own(self) -> Index:
        return np.arange(self.first)

    def after_a_power_up(self, precision: float) -> Ambiguity:
        """With three columns before all others: the offset of each axis that new data have beside
        the recording's, which says nothing of it. precision : of one at its unit"""
        p, grown = self.products, np.zeros((len(self.columns) + 3,) * 2)
        grown[:3, :3] = np.eye(3) * precision
        grown[3:, 3:] = p.gram
        return replace(
            self,
            columns=(*(f"next_bias_{a}" for a in "xyz"), *self.columns),
            blocks={name: at + 3 for name, at in self.blocks.items()},
            products=replace(p, gram=grown, along=np.concatenate([np.zeros(3), p.along])),
        )

    @cached_property
    def sizes(self) -> Mapping[str, Size]:
        """What the recording says of the size of every rival, were it the cause."""
        return {name: self._size(self.blocks[name]) for name in self.rivals}

    def _size(self, at: Index) -> Size:
        every, p = np.concatenate([self.own, at]), self.products
        inside = p.gram[np.ix_(every, every)]
        best = None
        for tau in TAU:
            prior = np.concatenate([np.full(self.first, _OPEN), np.full(at.size, tau**-2.0)])
            root = _root(inside + np.diag(prior))
            half = np.linalg.solve(root, p.along[every])
            left = max(p.power - float(half @ half), 1e-300)
            nats = -0.5 * (p.numbers - self.first) * np.log(left)
            nats += 0.5 * float(np.log(prior).sum()) - float(np.log(np.diag(root)).sum())
            if best is None or nats > best[0]:
                best = (nats, root, half)
        assert best is not None
        back = np.asarray(np.linalg.inv(best[1]).T, dtype=np.float64)
        return Size(every, np.asarray(back @ best[2]), back)


def _root(precision: Array) -> Array:
    """(k, k) lower triangular, whose square a precision is.

    Columns that the data hardly show leave directions whose precision drowns in the rounding of the
    others' products, which may be 1e15 times larger; it is then that of the rounding.
    """
    size = np.sqrt(np.diag(precision))
    value, vector = eigen(precision / np.outer(size, size))
    floor = max(_ROUNDING * len(size), -2.0 * float(value[0]))
    if value[0] > floor:
        return np.asarray(np.linalg.cholesky(precision))
    # The triangle of a square root by columns: no rounding makes it fail.
    upper = np.linalg.qr(np.sqrt(np.maximum(value, floor))[:, None] * vector.T * size, mode="r")
    return np.asarray((upper * np.sign(np.diag(upper))[:, None]).T)


@dataclass(frozen=True)
class Size:
    """Parameters of the base and one rival, at typical sizes: at : (k,) their columns; mean : (k,);
    root : (k, k) of their covariance"""

    at: Index
    mean: Array
    root: Array

    def drawn(self, rng: np.random.Generator, draws: int, scale: Array) -> Array:
        """(k, draws), the noise of each draw `scale` (draws,) times what is believed."""
        white = rng.standard_normal((len(self.mean), draws))
        return np.asarray(self.mean[:, None] + self.root @ white * scale)
