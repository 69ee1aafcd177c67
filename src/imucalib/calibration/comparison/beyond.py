"""How much values scatter beyond their own standard deviations, as a whole or within groups.

τ² solves Q(τ²) = Σ (y_i - ȳ)² / (v_i + τ²) = degrees of freedom (Paule and Mandel 1982; the
iterated DerSimonian and Laird 1986), its interval Q(τ²) = the quantiles of χ² (Viechtbauer 2007,
Statistics in Medicine 26, 37-52). ȳ is the mean of all, or of each group.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index


@dataclass(frozen=True)
class Beyond:
    """A standard deviation beyond stated ones, with its 95 % interval, in the values' unit."""

    sd: float
    low: float
    high: float


def beyond(value: Array, variance: Array, group: Index | None = None) -> Beyond:
    """Of values (m,) with variances (m,); group : (m,) whose means differ anyhow, or one for all.

    NaN where no group holds two.
    """
    from scipy.special import chdtri

    dof = value.size - (1 if group is None else np.unique(group).size)
    if dof < 1:
        return Beyond(float("nan"), float("nan"), float("nan"))
    wanted = (float(dof), float(chdtri(dof, 0.025)), float(chdtri(dof, 0.975)))
    return Beyond(*(_solved(q, value, variance, group) for q in wanted))


def beyond_sd(value: Array, variance: Array) -> float:
    """The same of one group, without its interval."""
    return _solved(value.size - 1.0, value, variance, None)


def chi_square(value: Array, variance: Array) -> float:
    """Weighted squares of values (m,) about their mean."""
    return _q(0.0, value, variance, None)


def _q(square: float, value: Array, variance: Array, group: Index | None) -> float:
    weight = 1.0 / (variance + square)
    if group is None:
        return float(weight @ (value - weight @ value / weight.sum()) ** 2)
    total = np.bincount(group, weight)
    mean = np.bincount(group, weight * value) / np.where(total > 0.0, total, 1.0)
    return float(weight @ (value - mean[group]) ** 2)


def _solved(wanted: float, value: Array, variance: Array, group: Index | None) -> float:
    """τ where Q(τ²) is so large; 0 where it never is."""
    from scipy.optimize import brentq

    if _q(0.0, value, variance, group) <= wanted:
        return 0.0
    high = float(np.ptp(value)) ** 2 + float(variance.max())
    while _q(high, value, variance, group) > wanted:
        high *= 4.0
    return float(
        np.sqrt(brentq(lambda s: _q(s, value, variance, group) - wanted, 0.0, high, xtol=1e-30))
    )
