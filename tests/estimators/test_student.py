"""Student's quantile against scipy's."""

from __future__ import annotations

import pytest
from scipy.special import stdtrit

from imucalib.estimators.student import quantile


@pytest.mark.parametrize("freedom", [1, 2, 3, 4, 7, 11, 30, 1000])
@pytest.mark.parametrize("probability", [0.6, 0.975, 0.995])
def test_the_quantile_is_the_published_one(freedom: int, probability: float) -> None:
    assert quantile(freedom, probability) == pytest.approx(stdtrit(freedom, probability), rel=1e-11)
