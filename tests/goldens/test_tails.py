"""Tails of distributions as the program uses them, against 40 digits of mpmath."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from goldens.test_programs import golden
from imucalib.calibrators.lab.advice import chance_of_factor
from imucalib.core.fit import Fit
from imucalib.estimators.power_ups import estimate_excess
from imucalib.posterior.held_out import add_density, difference


def test_the_interval_of_a_gain_is_students() -> None:
    """A mean over m parts has m - 1 degrees of freedom; folds share their data: sqrt(1 + K/(K-1))
    wider than the plain interval."""
    for dof, t in zip(*golden("student").values(), strict=True):
        rng, m = np.random.default_rng(int(dof)), int(dof) + 1
        before, after = 2.0 + rng.random(m), 1.0 + rng.random(m)
        off = before - after
        error = np.std(off, ddof=1) / np.sqrt(m)
        found = difference(before, after, np.arange(m), 10, "mean")
        half = t * error * np.sqrt(1.0 + 10.0 / 9.0)
        assert (found.high, found.low) == pytest.approx((off.mean() + half, off.mean() - half))
        nats = rng.standard_normal(m)
        low = nats.sum() - t * np.std(nats, ddof=1) * np.sqrt(m)
        assert add_density(found, nats).nats_low == pytest.approx(low, rel=1e-9)


def test_the_interval_of_a_parameter_is_students() -> None:
    """v = s² c has 2 v² / var(v) degrees of freedom (Giesbrecht and Burns 1985)."""
    for dof, t in zip(*golden("student").values(), strict=True):
        c, variance = np.array([[0.8, 0.1], [0.1, 0.5]]), 1.7
        fit = SimpleNamespace(
            covariance=variance * c,
            slope=c[None],
            noise_covariance=np.array([[2.0 * variance**2 / dof]]),
            dof=10**6,
            mixture=None,
        )
        fit.interval_dof = lambda direction, fit=fit: Fit.interval_dof(fit, direction)
        direction = np.array([1.0, -2.0])
        half = Fit.half_width(cast(Any, fit), direction)
        expected = t * np.sqrt(variance * float(direction @ c @ direction))
        assert half == pytest.approx(expected, rel=1e-9)


def test_more_scatter_than_declared_has_the_tail_of_chi_square() -> None:
    """A factor s of ν degrees of freedom has var(ln s) = 1 / 2ν; ν s² is chi-square."""
    for dof, x, tail in zip(*golden("chi_square").values(), strict=True):
        noise = SimpleNamespace(factor=np.sqrt(x / dof))
        fit = SimpleNamespace(noise=noise, noise_covariance=np.array([[0.5 / dof]]), dof=3)
        assert chance_of_factor(cast(Fit, fit)) == pytest.approx(tail, rel=1e-9, abs=1e-300)


def test_the_scatter_between_calibrations_has_the_ends_of_chi_square() -> None:
    """With equal variances v, Q(τ²) = S / (v + τ²), so τ² = S / χ² - v (Viechtbauer 2007)."""
    for dof, high, low in zip(*golden("chi_quantiles").values(), strict=True):
        value, v = np.random.default_rng(int(dof)).normal(0.0, 3.0, int(dof) + 1), 0.2
        squares = float(np.sum((value - value.mean()) ** 2))
        found = estimate_excess(value, np.full(value.size, v))
        expected = [np.sqrt(max(squares / x - v, 0.0)) for x in (dof, high, low)]
        assert (found.sd, found.low, found.high) == pytest.approx(expected, rel=1e-6)
