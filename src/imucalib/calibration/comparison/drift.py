"""Calibrations with dates: what drifts a day, and when a limit is reached.

Weighted least squares of a value on time, the variances those of the calibrations plus what they
scatter by about the line beyond them (from three on; moments as in `agreement`). Intervals are
Student's with m - 2 degrees of freedom, of two calibrations normal ones by the stated sds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array

#: Attitudes that chance sees independently: the largest of what nine parameters of like effect do
#: over 400 attitudes exceeds its 95 % quantile as the largest of 29 to 34 numbers does (simulated).
INDEPENDENT = 30


@dataclass(frozen=True)
class Slope:
    """Per day, with the half width of its 95 % interval, in the value's unit."""

    value: float
    half: float

    @property
    def shown(self) -> bool:
        """Whether the interval excludes zero."""
        return abs(self.value) > self.half


@dataclass(frozen=True)
class Due:
    """When a drift reaches a limit, days after the last calibration. attitude : (3,) where it does
    first; slope : there; expected : by the slope itself, infinite where none shows; earliest : by
    the upper edge of its interval"""

    slope: Slope
    attitude: Array
    limit: float
    unit: str
    expected: float
    earliest: float


def slope_of(days: Array, value: Array, variance: Array, among: int = 1) -> Slope:
    """days, value, variance : (m,); among : so many at once that the interval holds for all"""
    from scipy.special import ndtri, stdtrit

    m = days.size
    extra = _beyond(days, value, variance) if m > 2 else 0.0
    estimate, sd, _ = _line(days, value, variance + extra)
    level = 1.0 - 0.025 / among
    quantile = float(stdtrit(m - 2, level) if m > 2 else ndtri(level))
    return Slope(estimate, quantile * sd)


def due(
    days: Array, value: Array, variance: Array, attitude: Array, limit: float, *, sensors: int = 1
) -> Due:
    """value, variance : (m, n) in mg, in n attitudes (n, 3); limit : mg; sensors : so many"""
    among = INDEPENDENT * sensors
    slopes = [slope_of(days, v, s, among) for v, s in zip(value.T, variance.T, strict=True)]
    reach = np.array([abs(s.value) + s.half for s in slopes])
    shown = np.array([abs(s.value) if s.shown else 0.0 for s in slopes])
    at = int(np.argmax(np.where(shown.any(), shown, reach)))
    fastest = float(shown.max())
    return Due(
        slope=slopes[at],
        attitude=attitude[at],
        limit=limit,
        unit="mg",
        expected=limit / fastest if fastest > 0.0 else np.inf,
        earliest=float(limit / reach.max()),
    )


def _line(days: Array, value: Array, variance: Array) -> tuple[float, float, float]:
    """Slope, its sd and the weighted sum of squares about the line."""
    weight = 1.0 / variance
    middle = float(weight @ days / weight.sum())
    mean = float(weight @ value / weight.sum())
    away = days - middle
    power = float(weight @ away**2)
    slope = float(weight @ (away * (value - mean))) / power
    return slope, power**-0.5, float(weight @ (value - mean - slope * away) ** 2)


def _beyond(days: Array, value: Array, variance: Array) -> float:
    """Variance about the line beyond the stated ones: Q = m - 2."""
    from scipy.optimize import brentq

    def q(extra: float) -> float:
        return _line(days, value, variance + extra)[2] - (days.size - 2)

    if q(0.0) <= 0.0:
        return 0.0
    high = float(np.ptp(value)) ** 2 + float(variance.max())
    while q(high) > 0.0:
        high *= 4.0
    return float(brentq(q, 0.0, high))
