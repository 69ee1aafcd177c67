"""Cholesky factors of thousands of small matrices at once, the matrices last in memory.

A library call for each of them costs ten times what its few sums do.
"""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array


def lower_factor(matrix: Array) -> Array:
    """(n, n, T) lower triangles L with L Lᵀ the positive matrices (n, n, T), of which only the
    lower half is read; NaN where one is not positive."""
    out = np.zeros_like(matrix)
    for j in range(len(matrix)):
        column = matrix[j:, j] - np.einsum("kt,ikt->it", out[j, :j], out[j:, :j])
        out[j:, j] = column / np.sqrt(column[0])
    return out


def inverse_of_lower(lower: Array) -> Array:
    """(n, n, T) inverses of lower triangles (n, n, T)."""
    out = np.zeros_like(lower)
    for i in range(len(lower)):
        out[i, i] = 1.0 / lower[i, i]
        out[i, :i] = np.einsum("kt,kjt->jt", lower[i, :i], out[:i, :i]) * -out[i, i]
    return out


def solved_by(lower: Array, right: Array) -> Array:
    """(n, T) solutions x of L Lᵀ x = right (n, T)."""
    out = right.copy()
    for i in range(len(out)):
        out[i] = (out[i] - np.einsum("kt,kt->t", lower[i, :i], out[:i])) / lower[i, i]
    for i in reversed(range(len(out))):
        out[i] = (out[i] - np.einsum("kt,kt->t", lower[i + 1 :, i], out[i + 1 :])) / lower[i, i]
    return out
