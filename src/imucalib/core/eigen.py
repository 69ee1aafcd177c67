"""Eigenvectors of symmetric matrices, also where the fast method gives up, and block by block where
a matrix comes apart.

Divide and conquer, numpy's method, now and then fails on a good matrix whose eigenvalues coincide,
as those of three like axes do (seen: 36 x 36, each value three times). QR iteration is slower and
does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from imucalib.arrays import Array, Index

if TYPE_CHECKING:
    from scipy.sparse import csr_array


def eigen(matrices: Array) -> tuple[Array, Array]:
    """Ascending eigenvalues (..., n) and orthonormal eigenvectors (..., n, n) of (..., n, n).

    Raises numpy.linalg.LinAlgError where neither method succeeds: an entry is not finite.
    """
    try:
        values, vectors = np.linalg.eigh(matrices)
    except np.linalg.LinAlgError:
        return _by_iteration(matrices)
    return values, vectors


def _by_iteration(matrices: Array) -> tuple[Array, Array]:
    from scipy.linalg import eigh

    if not np.isfinite(matrices).all():
        raise np.linalg.LinAlgError("eigenvalues of a matrix that is not finite")
    values = np.empty(matrices.shape[:-1])
    vectors = np.empty(matrices.shape)
    for at in np.ndindex(matrices.shape[:-2]):
        values[at], vectors[at] = eigh(matrices[at], driver="ev")
    return values, vectors


def blocks_of(columns: Array | csr_array) -> list[Index]:
    """The rows of each block of columns (N, q): rows that have a column in common, or are joined
    through others, are in one. All rows are in one where a column has half of them."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n, q = columns.shape
    row, column = columns.nonzero()
    if 2 * np.bincount(column, minlength=1).max() >= n:
        return [np.arange(n)]
    size = (n + q, n + q)
    graph = coo_array((np.ones(row.size), (row, n + column)), shape=size)
    label = connected_components(graph, directed=False)[1][:n]
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def eigen_by_blocks(columns: Array, blocks: Sequence[Index]) -> tuple[Array, csr_array]:
    """Eigenvalues (N,) and eigenvectors (N, N) of columns columns', whose blocks are known."""
    from scipy.sparse import csr_array

    size = np.array([len(rows) for rows in blocks])
    spread, entries = np.zeros(len(columns)), []
    for m in np.unique(size):
        at = np.stack([rows for rows in blocks if len(rows) == m])
        used = [np.flatnonzero(columns[rows].any(axis=0)) for rows in at]
        own = np.zeros((len(at), m, max(len(some) for some in used)))
        for k, some in enumerate(used):
            own[k, :, : len(some)] = columns[np.ix_(at[k], some)]
        values, vectors = eigen(own @ own.swapaxes(-1, -2))
        spread[at] = np.maximum(values, 0.0)
        first, second = np.broadcast_arrays(at[:, :, None], at[:, None, :])
        entries.append((vectors.ravel(), first.ravel(), second.ravel()))
    value, row, column = (np.concatenate(part) for part in zip(*entries, strict=True))
    return spread, csr_array((value, (row, column)), shape=(len(columns),) * 2)
