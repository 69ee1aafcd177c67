"""Eigenvectors are had where the fast method fails."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imucalib.core import eigen as eigen_module
from imucalib.core.eigen import eigen


def _gives_up(matrices: np.ndarray) -> None:
    raise np.linalg.LinAlgError("Eigenvalues did not converge")


@pytest.mark.parametrize("shape", [(5, 5), (3, 4, 4), (2, 3, 2, 2)])
@pytest.mark.parametrize("fails", [False, True])
def test_a_matrix_is_what_its_eigenvectors_say(
    shape: tuple[int, ...], fails: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = np.random.default_rng(3).normal(size=shape)
    matrices = root @ np.swapaxes(root, -1, -2)
    if fails:
        monkeypatch.setattr(np.linalg, "eigh", _gives_up)
    values, vectors = eigen(matrices)
    np.testing.assert_allclose(
        (vectors * values[..., None, :]) @ np.swapaxes(vectors, -1, -2), matrices, atol=1e-12
    )
    assert np.all(np.diff(values, axis=-1) >= 0.0)


def test_a_hole_is_not_decomposed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(np.linalg, "eigh", _gives_up)
    with pytest.raises(np.linalg.LinAlgError):
        eigen(np.full((2, 2), np.nan))


def test_the_fast_method_is_called_here_alone() -> None:
    root = Path(eigen_module.__file__).parents[1]
    callers = {p.name for p in root.rglob("*.py") if "linalg.eigh(" in p.read_text("utf-8")}
    assert callers == {"eigen.py"}
