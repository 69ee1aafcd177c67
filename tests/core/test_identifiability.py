"""What data leave open, in words and on either side of the limit."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.core.effect import Parameter
from imucalib.core.fit import null_directions

NAMES = tuple(Parameter(name, "mg", 10.0, 99.0) for name in "abcdefg")


def told(jacobian: np.ndarray, factor: float = 1.0) -> tuple[str, ...]:
    return null_directions(jacobian, NAMES[: jacobian.shape[1]], factor)


@pytest.mark.parametrize(("sd", "open_"), [(29.0, False), (31.0, True)])
def test_open_is_known_worse_than_three_typical_sizes(sd: float, open_: bool) -> None:
    jacobian = np.diag([1.0, 1.0 / sd])
    assert told(jacobian) == (("b is not determined",) if open_ else ())
    assert told(2.0 * jacobian, 2.0) == told(jacobian)


def test_a_combination_is_told_by_its_largest_parts() -> None:
    """Those of a fifth of the largest or more, five at most, largest first."""
    way = np.array([1.0, -0.21, 0.19, 0.0, 0.0, 0.0, 0.0])
    way /= np.linalg.norm(way)
    assert told(np.eye(7) - np.outer(way, way)) == ("a cannot be told from b",)
    many = np.array([0.9, 1.0, 0.8, 0.7, 0.6, 0.5, 0.4])
    many /= np.linalg.norm(many)
    assert told(np.eye(7) - np.outer(many, many)) == ("b cannot be told from a, c, d, e",)
    rows = np.repeat(np.eye(7)[:3], 9, axis=0)
    assert len(told(rows)) == 4
    assert len(told(rows[:2])) == 6
    assert null_directions(np.zeros((4, 0)), (), 1.0) == ()
