"""The scatter between power-ups: sizes weighed as a tree of priors says, and each one's offset."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.calibrators.lab.sessions import between
from imucalib.calibrators.lab.sessions.between import _allowed, _offsets


def test_sizes_of_axes_are_weighed_about_that_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every sum of the tree by loops: a size of all, 1 / (size + noise) beforehand, an axis' log
    size normal about it with sd 0.5, the likelihood of each axis by itself."""
    matrix = np.zeros((12, 6))
    matrix[:6, :3], matrix[6:, 3:] = np.tile(np.eye(3), (2, 1)), np.tile(np.eye(3), (2, 1))
    matrix[:, 5] = 0.0  # a column that no row sees counts for no length
    fit = SimpleNamespace(
        at=SimpleNamespace(settings=(matrix,)), noise=SimpleNamespace(factor=0.8, sd=(3.0,))
    )

    def nats(_: object, __: int, axis: int, size: float) -> float:
        return float(-0.5 * ((np.log(size) - (0.2, 1.0, 0.7)[axis]) / 0.4) ** 2) + 5.0 * axis

    monkeypatch.setattr(between, "_nats", nats)
    sizes, all_axes, each = _allowed(fit, 0)  # type: ignore[arg-type]
    alone = 0.8 / np.sqrt(2.0)  # of two rows a column
    assert sizes[0] == pytest.approx(0.05 * alone)
    assert sizes[-1] == pytest.approx(30.0 * 3.0)
    np.testing.assert_allclose(np.diff(np.log(sizes)), np.log(sizes[1] / sizes[0]))
    q = len(sizes)
    weight, by_axis = np.zeros(q), np.zeros((3, q))
    for s in range(q):
        near = np.exp(-0.5 * (np.log(sizes / sizes[s]) / 0.5) ** 2)
        near = near / near.sum()  # of an axis, given that of all
        seen = [
            np.array([near[a] * np.exp(nats(0, 0, axis, sizes[a])) for a in range(q)])
            for axis in range(3)
        ]
        prior = sizes[s] / (sizes[s] + alone)  # on steps of the logarithm
        whole = prior * np.prod([part.sum() for part in seen])
        weight[s] = whole
        for axis in range(3):
            by_axis[axis] += whole * seen[axis] / seen[axis].sum()
    np.testing.assert_allclose(all_axes, weight / weight.sum(), rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(
        each, by_axis / by_axis.sum(axis=1, keepdims=True), rtol=1e-6, atol=1e-12
    )


def test_offsets_are_conditional_means_beside_the_model() -> None:
    """Of y = J θ + N u + e with flat θ, u ~ s² and another component v: by covariance matrices."""
    rng = np.random.default_rng(3)
    n = 14
    jacobian, own, other = (rng.standard_normal((n, k)) for k in (2, 3, 2))
    y, factor, size, beside = rng.standard_normal(n), 0.7, 1.3, 0.4
    fit = SimpleNamespace(
        at=SimpleNamespace(settings=(other, own), jacobian=jacobian, residual=y),
        noise=SimpleNamespace(factor=factor, sd=(beside, size),
                              ratio=(beside / factor, size / factor)),
    )  # fmt: skip
    found, sd = _offsets(fit, 1)  # type: ignore[arg-type]
    rest = factor**2 * np.eye(n) + beside**2 * other @ other.T + 1e8 * jacobian @ jacobian.T
    whole = rest + size**2 * own @ own.T
    gain = size**2 * own.T @ np.linalg.inv(whole)
    np.testing.assert_allclose(found, gain @ y, rtol=1e-5)
    left = size**2 * np.eye(3) - gain @ own * size**2
    np.testing.assert_allclose(sd, np.sqrt(np.diag(left)), rtol=1e-5)
