"""Low-passes whose times are against a reference that lags itself, by transfer functions."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.core.course import course_of, slope_of
from imucalib.effects.array.low_pass import slowed

H = 0.01
T = np.arange(600) * H
TONES = 2.0 * np.pi * np.array([0.7, 1.9, 3.8])


def behind(tau: float) -> np.ndarray:
    """(n, 3) of three tones behind a low-pass of `tau` s: 1 / (1 + i w tau)."""
    return np.imag(np.exp(1j * TONES * T[:, None]) / (1.0 + 1j * TONES * tau))


@pytest.mark.parametrize("reference", [0.0, 2e-3])
def test_times_against_a_reference_that_is_slow_itself(reference: float) -> None:
    """What is quicker than the reference has a negative time against it. (Second order of a time:
    (6 ms times 24 rad/s)² is 2 %.)"""
    true = np.array([reference, 0.0, 6e-3])
    value = np.repeat(behind(reference)[:, None], 3, axis=1)
    beside = np.stack([np.arange(600) > 0, np.arange(600) < 599], axis=1)
    course = course_of(value, slope_of(value, T, beside), T, beside)
    lag = np.broadcast_to((true - reference)[:, None], (600, 3, 1))
    found = slowed(course, lag)
    kept = slice(50, -50)
    for k, tau in enumerate(true):
        want = behind(tau)
        slope = np.gradient(want, H, axis=0, edge_order=2)
        assert np.abs(found.value[kept, k] - want[kept]).max() < 2e-4
        assert np.abs(found.slope[kept, k] - slope[kept]).max() < 0.02 * TONES[-1]
