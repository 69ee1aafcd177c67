"""What sensors that move get wrong, per unit: the parts of effects and of laws without a name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from operator import attrgetter

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Basis, Context, Truth, cross_matrix, own_axis

#: Something (n, K, 3) that each axis senses.
Quantity = Callable[[Truth], Array]
FORCE: Quantity = attrgetter("force")
RATE: Quantity = attrgetter("turning.rate")
SPIN: Quantity = attrgetter("turning.spin")
JERK: Quantity = attrgetter("turning.jerk")
#: Pairs of an axis and another, as columns of `other_axes` and in the names of its numbers.
OTHERS = tuple((i, j) for i in range(3) for j in range(3) if i != j)


def one(truth: Truth) -> Array:
    """The same for all axes, whatever they sense."""
    return np.ones(truth.shape)


def each_axis(quantity: Quantity, unit: float) -> Basis:
    """Three numbers: each axis adds what it senses times its own."""
    return lambda truth, context: own_axis(unit * quantity(truth))


def all_axes(quantity: Quantity, unit: float) -> Basis:
    """One number: every axis adds what it senses times the same."""
    return lambda truth, context: unit * quantity(truth)[..., None]


def elements(matrix: Array) -> Array:
    """(n, K, 3, 9): axis i adds the row i of a matrix (n, K, 3, 3), each element by its own
    number."""
    out = np.zeros((*matrix.shape[:3], 9))
    for i in range(3):
        out[..., i, 3 * i : 3 * i + 3] = matrix[..., i, :]
    return out


def any_axis(quantity: Quantity, unit: float) -> Basis:
    """Nine numbers: each axis adds what all three sense."""

    def basis(truth: Truth, context: Context) -> Array:
        seen = unit * quantity(truth)
        return elements(np.broadcast_to(seen[..., None, :], (*truth.shape, 3)))

    return basis


def other_axes(quantity: Quantity, unit: float) -> Basis:
    """Six numbers: each axis adds what the other two sense."""
    every = any_axis(quantity, unit)
    return lambda truth, context: every(truth, context)[..., [3 * i + j for i, j in OTHERS]]


def displace(truth: Truth, context: Context) -> Array:
    """Three numbers, mm: W d = ω × (ω × d) + dω/dt × d of a place that is d off, in each package's
    axes."""
    w, turned = truth.turning.rate, cross_matrix(truth.turning.spin)
    square = np.sum(w * w, axis=-1)[..., None, None] * np.eye(3)
    return np.asarray(1e-3 * (w[..., :, None] * w[..., None, :] - square + turned))


def times(part: Basis, factor: Callable[[Truth, Context], Array]) -> Basis:
    """A part that goes with a covariate or with what is sensed, (n,), (n, 1) or (n, K)."""

    def basis(truth: Truth, context: Context) -> Array:
        share = factor(truth, context).reshape(len(truth.force), -1, 1, 1)
        return np.asarray(part(truth, context) * share)

    return basis


def by_force(basis: Basis) -> Basis:
    """The derivative (n, K, 3, m, 3) by the specific force, of a basis that is linear in it."""

    def slope(truth: Truth, context: Context) -> Array:
        along = (replace(truth, force=np.broadcast_to(e, truth.shape)) for e in np.eye(3))
        return np.stack([basis(one, context) for one in along], axis=-1)

    return slope
