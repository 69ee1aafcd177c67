"""Columns with others taken out of them, from their products alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.eigen import eigen

_COLUMNS = 512  # that are worked on at a time


@dataclass(frozen=True)
class Gram:
    """matrix : (M, M); along : (M,) products with the residual; power : of the residual;
    numbers : how many the residual has, less the motion's; whole : (M,) squares before the motion
    is taken out"""

    matrix: Array
    along: Array
    power: float
    numbers: int
    whole: Array

    def __add__(self, other: Gram) -> Gram:
        return replace(self, matrix=self.matrix.copy()).added(other)

    def added(self, other: Gram) -> Gram:
        """The sum, in the place of this one's matrix: of many IMUs a third would be large."""
        np.add(self.matrix, other.matrix, out=self.matrix)
        return Gram(
            self.matrix,
            self.along + other.along,
            self.power + other.power,
            self.numbers + other.numbers,
            self.whole + other.whole,
        )


@dataclass(frozen=True)
class Reduced:
    """Columns with the base taken out: matrix (m, m), along (m,), power, and the base's own
    solution : (b,) step and covariance (b, b); carry : (b, m) base per unit of each column."""

    matrix: Array
    along: Array
    power: float
    step: Array
    covariance: Array
    carry: Array


def reduced(found: Gram, prior: Array, pull: Array) -> Reduced:
    """Take the base, the first columns, out of those that follow it, in the place of their matrix:
    of many IMUs another would be large.

    prior : (b,) inverse variances of the base's parameters, zero for free ones; pull : (b,) prior
    times how far they stand from their means
    """
    b = len(prior)
    half = inverse_root(found.matrix[:b, :b] + np.diag(prior))
    across = half.T @ found.matrix[:b, b:]
    right = half.T @ (found.along[:b] - pull)
    matrix = found.matrix[b:, b:]
    for a in range(0, len(matrix), _COLUMNS):
        matrix[a : a + _COLUMNS] -= across[:, a : a + _COLUMNS].T @ across
    return Reduced(
        matrix,
        found.along[b:] - across.T @ right,
        found.power - float(right @ right),
        half @ right,
        half @ half.T,
        half @ across,
    )


def inverse_root(inner: Array) -> Array:
    """(b, q) with root rootᵀ the inverse of a matrix, its open directions left out."""
    size = 1.0 / np.sqrt(np.maximum(np.diag(inner), 1e-300))
    return np.asarray(size[:, None] * _half(inner * size[:, None] * size))


def _half(unit: Array) -> Array:
    """(b, q) with half halfᵀ the inverse of a matrix of unit diagonal, its open directions left
    out."""
    from scipy.linalg.lapack import dtrtri

    try:
        lower = np.linalg.cholesky(unit)
        if float(np.diag(lower).min(initial=1.0)) > 1e-4:
            return np.asarray(dtrtri(lower, lower=1)[0].T)
    except np.linalg.LinAlgError:
        pass
    values, vectors = eigen(unit)
    use = values > 1e-11 * max(float(values[-1]), 1e-300)
    return np.asarray(vectors[:, use] / np.sqrt(values[use]))
