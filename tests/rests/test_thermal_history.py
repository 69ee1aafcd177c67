"""A lag is a recursion from reading to reading; here it is one, in the code it is sums."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.rests.thermal import ThermalHistory


@pytest.mark.parametrize("hours", [1e-4, 0.003, 0.1, 3.0, 1e4])
@pytest.mark.parametrize("size", [2, 7, 700])
def test_a_lag_goes_a_share_of_the_way_at_each_reading(hours: float, size: int) -> None:
    time = 10.0 * np.arange(size)
    warm = 25.0 + np.random.default_rng(size).normal(size=size).cumsum()
    share = -np.expm1(-10.0 / (3600.0 * hours))
    expected = [warm[0]]
    for reading in warm[1:]:
        expected.append(expected[-1] + share * (reading - expected[-1]))
    got = ThermalHistory(time, warm).lagged(hours, time)
    np.testing.assert_allclose(got, expected, atol=1e-9)
