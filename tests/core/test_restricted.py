"""What is left of a balance, held against dense matrices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imucalib.arrays import Array
from imucalib.core.restricted import restricted


def _rig(seed: int, rows: int = 30) -> tuple[Array, tuple[Array, ...], Array]:
    """A jacobian (N, 5), two settings of few columns and one of as many as numbers, and data."""
    rng = np.random.default_rng(seed)
    jacobian = rng.standard_normal((rows, 5))
    few = tuple(rng.standard_normal((rows, q)) for q in (3, 6))
    return jacobian, (*few, rng.standard_normal((rows, rows))), rng.standard_normal((rows, 4))


def _dense(components: tuple[Array, ...], ratio: tuple[float, ...]) -> Array:
    whole = np.eye(len(components[0]))
    for matrix, size in zip(components, ratio, strict=True):
        whole += size**2 * matrix @ matrix.T
    return whole


def _settings(seed: int, rows: int = 30) -> Array:
    """A component of settings that one, two, three or four numbers share, some numbers none."""
    rng = np.random.default_rng(seed + 1000)
    owner = rng.permutation(np.repeat(np.arange(14), rng.integers(1, 5, 14))[: rows - 2])
    matrix = np.zeros((rows, 14))
    matrix[np.arange(owner.size), owner] = rng.standard_normal(owner.size)
    return matrix[:, matrix.any(axis=0)]


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 999), sizes=st.lists(st.floats(0.0, 30.0), min_size=3, max_size=3))
@pytest.mark.parametrize("kind", ["shared by all", "settings", "narrow"])
def test_the_restricted_likelihood_is_that_of_dense_matrices(
    kind: str, seed: int, sizes: list[float]
) -> None:
    """y'Py and log|V| + log|J'V⁻¹J| - log|J'J|, by their definitions, and V⁻¹'s diagonal."""
    jacobian, components, data = _rig(seed)
    third = {"shared by all": components[2:], "settings": (_settings(seed),), "narrow": ()}[kind]
    components = (*components[:2], *third)
    ratio = tuple(sizes[: len(components)])
    left = restricted(jacobian, components)
    assert left.wide == (2 if third else -1)
    assert (left.out.shape[1] > 0) == (kind == "settings")
    assert left.freedom == len(jacobian) - jacobian.shape[1]
    found = left.at(np.array(ratio))
    power = [found.power(found.solve(left.turned(one))) for one in data.T]
    expected, logs = _projected(jacobian, _dense(components, ratio), data)
    assert power == pytest.approx(expected, rel=1e-7)
    assert found.log_det == pytest.approx(logs, rel=1e-8, abs=1e-8)
    unit = np.eye(len(jacobian))
    turned = _projected(jacobian, _dense(components, ratio), unit)[0]
    assert np.sum(found.own) == pytest.approx(np.sum(turned), rel=1e-8)


def _projected(jacobian: Array, covariance: Array, data: Array) -> tuple[Array, float]:
    """y'Py of every column, and log|V| + log|J'V⁻¹J| - log|J'J|."""
    inverse = np.linalg.inv(covariance)
    weighted = jacobian.T @ inverse
    project = inverse - weighted.T @ np.linalg.solve(weighted @ jacobian, weighted)
    logs = -np.linalg.slogdet(inverse)[1] + np.linalg.slogdet(weighted @ jacobian)[1]
    logs -= np.linalg.slogdet(jacobian.T @ jacobian)[1]
    return np.einsum("nd,nm,md->d", data, project, data), float(logs)


def test_what_large_settings_leave_is_not_lost() -> None:
    """Settings that scatter by a million times the noise: the rest is known to a part in 1e6."""
    jacobian, components, data = _rig(2)
    column = components[0]
    left = restricted(jacobian, (column,))
    both = np.column_stack([jacobian, column])
    rest = data - both @ np.linalg.lstsq(both, data, rcond=None)[0]
    moved = left.turned(data + 1e6 * column @ np.ones((column.shape[1], data.shape[1])))
    expected = pytest.approx((rest**2).sum(axis=0) + column.shape[1], rel=1e-5)
    found = left.at(np.array([1e6]))
    assert [found.power(found.solve(one)) for one in moved.T] == expected
