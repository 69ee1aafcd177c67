"""What a play makes of the temperature, against its definition, one reading after the other."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.rests.thermal import ThermalHistory, remembered


def behind(values: np.ndarray, width: float) -> np.ndarray:
    at, found = values[0], []
    for value in values:
        at = min(max(at, value - width / 2.0), value + width / 2.0)
        found.append(at)
    return np.array(found)


@pytest.mark.parametrize("n", [1, 2, 3, 50, 1025])
def test_a_play_moves_only_at_its_ends(n: int) -> None:
    values = 30.0 + np.cumsum(np.random.default_rng(n).standard_normal(n))
    history = ThermalHistory(10.0 * np.arange(n), values)
    for width in (0.5, 2.0, 6.0):
        got = history.behind_play(width, history.time)
        np.testing.assert_allclose(got, behind(values, width), atol=1e-12)


def test_the_rate_is_the_slope_of_a_steady_warming() -> None:
    """Five time constants after the start; 3 °C an hour."""
    time = np.arange(5.0, 7200.0, 10.0)
    history = ThermalHistory(time, 20.0 + 3.0 * time / 3600.0)
    rate = remembered(history, "temperature_rate_12min", np.array([3600.0, 7000.0]))
    np.testing.assert_allclose(rate, 3.0, rtol=0.02)
