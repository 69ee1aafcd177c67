"""Eigenvectors of symmetric matrices, also where the fast method gives up.

Divide and conquer, numpy's method, now and then fails on a good matrix whose eigenvalues coincide,
as those of three like axes do (seen: 36 x 36, each value three times). QR iteration is slower and
does not.
"""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array


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
