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


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 999), sizes=st.lists(st.floats(0.0, 30.0), min_size=3, max_size=3))
@pytest.mark.parametrize("wide", [True, False])
def test_the_restricted_likelihood_is_that_of_dense_matrices(
    wide: bool, seed: int, sizes: list[float]
) -> None:
    """y'Py and log|V| + log|J'V⁻¹J| - log|J'J|, by their definitions."""
    jacobian, components, data = _rig(seed)
    components, ratio = (components, tuple(sizes)) if wide else (components[:2], tuple(sizes[:2]))
    left = restricted(jacobian, components)
    assert left.wide == (2 if wide else -1)
    found = left.at([ratio])
    inverse = np.linalg.inv(_dense(components, ratio))
    weighted = jacobian.T @ inverse
    project = inverse - weighted.T @ np.linalg.solve(weighted @ jacobian, weighted)
    expected = np.einsum("nd,nm,md->d", data, project, data)
    power = found.power(found.solve(left.frame.T @ data))[0]
    assert power == pytest.approx(expected, rel=1e-7)
    logs = -np.linalg.slogdet(inverse)[1] + np.linalg.slogdet(weighted @ jacobian)[1]
    logs -= np.linalg.slogdet(jacobian.T @ jacobian)[1]
    assert found.log_det[0] == pytest.approx(logs, rel=1e-8, abs=1e-8)


def test_several_noises_at_once_are_each_by_itself() -> None:
    jacobian, components, data = _rig(1)
    left = restricted(jacobian, components[:2])
    ratios = ((0.1, 2.0), (3.0, 0.0))
    both, inside = left.at(ratios), left.frame.T @ data
    for k, ratio in enumerate(ratios):
        one = left.at([ratio])
        assert np.allclose(both.solve(inside)[0][k], one.solve(inside)[0][0], rtol=1e-12)
        assert both.log_det[k] == pytest.approx(one.log_det[0], rel=1e-12)


def test_what_large_settings_leave_is_not_lost() -> None:
    """Settings that scatter by a million times the noise: the rest is known to a part in 1e6."""
    jacobian, components, data = _rig(2)
    column = components[0]
    left = restricted(jacobian, (column,))
    found = left.at([(1e6,)])
    both = np.column_stack([jacobian, column])
    rest = data - both @ np.linalg.lstsq(both, data, rcond=None)[0]
    moved = data + 1e6 * column @ np.ones((column.shape[1], data.shape[1]))
    power = found.power(found.solve(left.frame.T @ moved))[0]
    assert power == pytest.approx((rest**2).sum(axis=0) + column.shape[1], rel=1e-5)


def test_a_direction_that_the_data_leave_open_is_no_parameter() -> None:
    jacobian = _rig(3)[0]
    twice = np.column_stack([jacobian, jacobian[:, 0] + jacobian[:, 1]])
    assert restricted(twice, ()).frame.shape == restricted(jacobian, ()).frame.shape
