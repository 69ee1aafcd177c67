"""Steps of the search for a sample's rate where its Hessian is not positive definite."""

from __future__ import annotations

import numpy as np

from imucalib.estimators.array.rates import inverse
from imucalib.estimators.array.rotation import full


def packed(matrices: np.ndarray) -> np.ndarray:
    """(1, 6, T) of symmetric matrices (T, 3, 3): xx, yy, zz, xy, xz, yz."""
    rows, columns = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
    return matrices[:, rows, columns].T[None]


def worlds() -> tuple[np.ndarray, np.ndarray]:
    """Symmetric matrices (4, 3, 3) of which the last two are indefinite, one of them nearly flat;
    gradients (1, 3, 4)."""
    rng = np.random.default_rng(4)
    turns = np.linalg.qr(rng.normal(size=(4, 3, 3)))[0]
    values = np.array([[1.0, 2.0, 3.0], [5.0, 0.1, 2.0], [4.0, -2.0, 1.0], [-3.0, 1e-9, 2.0]])
    matrices = np.einsum("nij,nj,nkj->nik", turns, values, turns)
    return 0.5 * (matrices + matrices.transpose(0, 2, 1)), rng.normal(size=(1, 3, 4))


def test_six_numbers_are_the_symmetric_matrix() -> None:
    matrices, _ = worlds()
    np.testing.assert_array_equal(full(packed(matrices))[0], matrices.transpose(1, 2, 0))


def test_the_inverse_and_which_are_positive() -> None:
    matrices, _ = worlds()
    found, det, positive = inverse(packed(matrices))
    np.testing.assert_allclose(found[0], packed(np.linalg.inv(matrices))[0], rtol=1e-6)
    np.testing.assert_allclose(det[0], np.linalg.det(matrices), rtol=1e-6, atol=1e-12)
    assert positive[0].tolist() == [True, True, False, False]
