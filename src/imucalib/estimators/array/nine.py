"""The nine unknowns of a sample's motion: factors, roots and solutions of thousands of matrices at
once, the matrices last in memory. A library call for each costs ten times what its few sums do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array


@dataclass(frozen=True)
class Factor:
    """Matrices (T, 9, 9) on their way to their inverses. All accelerometers see s alike, so that
    its block is a number `own` (T,) times one, and six unknowns are left when s is taken out by
    `across` (T, 3, 6): in like units, size (6, T), they have the lower triangle (6, 6, T)."""

    own: Array
    across: Array
    size: Array
    lower: Array


def factored(matrix: Array) -> Factor:
    """Of positive matrices (T, 9, 9); NaN where one is not."""
    own = matrix[:, 0, 0]
    across = matrix[:, :3, 3:] / own[:, None, None]
    taken = np.matmul(across.transpose(0, 2, 1), matrix[:, :3, 3:])
    left = np.ascontiguousarray((matrix[:, 3:, 3:] - taken).transpose(1, 2, 0))
    # In like units: a spin that only its prior holds is a small number beside the others.
    size = 1.0 / np.sqrt(np.einsum("iit->it", left))
    left *= size[:, None]
    left *= size
    return Factor(own, across, size, _lower(left))


def root_of(factor: Factor) -> Array:
    """(T, 9, 9) with root rootᵀ the inverse of each matrix, upper triangular."""
    six = (_inverse(factor.lower) * factor.size).transpose(2, 1, 0)
    root = np.zeros((len(six), 9, 9))
    root[:, range(3), range(3)] = 1.0 / np.sqrt(factor.own)[:, None]
    root[:, 3:, 3:] = six
    root[:, :3, 3:] = -np.matmul(factor.across, six)
    return root


def solved(factor: Factor, right: Array) -> Array:
    """(T, 9) solutions of such systems."""
    pull = right[:, 3:] - np.matmul(right[:, None, :3], factor.across)[:, 0]
    six = (_solution(factor.lower, pull.T * factor.size) * factor.size).T
    first = right[:, :3] / factor.own[:, None] - np.matmul(factor.across, six[..., None])[..., 0]
    return np.concatenate([first, six], axis=1)


def _lower(matrix: Array) -> Array:
    """(n, n, T) lower triangles L with L Lᵀ the positive matrices (n, n, T), of which only the
    lower half is read; NaN where one is not positive."""
    out = np.zeros_like(matrix)
    for j in range(len(matrix)):
        column = matrix[j:, j] - np.einsum("kt,ikt->it", out[j, :j], out[j:, :j])
        out[j:, j] = column / np.sqrt(column[0])
    return out


def _inverse(lower: Array) -> Array:
    """(n, n, T) inverses of lower triangles (n, n, T)."""
    out = np.zeros_like(lower)
    for i in range(len(lower)):
        out[i, i] = 1.0 / lower[i, i]
        out[i, :i] = np.einsum("kt,kjt->jt", lower[i, :i], out[:i, :i]) * -out[i, i]
    return out


def _solution(lower: Array, right: Array) -> Array:
    """(n, T) solutions x of L Lᵀ x = right (n, T)."""
    out = right.copy()
    for i in range(len(out)):
        out[i] = (out[i] - np.einsum("kt,kt->t", lower[i, :i], out[:i])) / lower[i, i]
    for i in reversed(range(len(out))):
        out[i] = (out[i] - np.einsum("kt,kt->t", lower[i + 1 :, i], out[i + 1 :])) / lower[i, i]
    return out
