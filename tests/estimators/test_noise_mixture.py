"""Intervals with the noise integrated out, against an integral on a grid of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.core.observations import NoisePrior
from imucalib.estimators.least_squares import fit
from imucalib.estimators.noise_mixture import integrate_noise
from imucalib.units import DEG
from worlds.bench import base_model, bench, draw, ordinary_theta

PRIOR = NoisePrior(spread=0.7, setting=0.1 * DEG, parameters={"scale_x": 0.01, "bias_x": 30.0})


@pytest.mark.parametrize("seed", [1])
def test_the_covariance_is_that_of_an_integral_on_a_grid(seed: int) -> None:
    """Eight rows: log-normal factor, half-Cauchy settings, θ normal given them."""
    base, data = base_model(), replace(bench(seed, 8), noise_prior=PRIOR)
    got = integrate_noise(fit(base, draw(base, ordinary_theta(base, data, seed), data, seed)))
    at, n = got.at, got.at.residual.size
    start = np.array([p.start for p in got.parameters])
    known, off = np.diag(got.known_sd**-2.0), start - got.theta
    factor = np.exp(np.linspace(-2.1, 2.1, 13))
    setting = PRIOR.setting * np.exp(np.linspace(-4.5, 4.5, 16))
    logs, means, covariances = [], [], []
    for f in factor:
        for a in setting:
            for b in setting:
                v = f**2 * np.eye(n) + sum(
                    s**2 * m @ m.T for s, m in zip((a, b), at.settings, strict=True)
                )
                solved = np.linalg.solve(v, np.column_stack([at.jacobian, at.residual]))
                inner = at.jacobian.T @ solved[:, :-1] + known
                along = at.jacobian.T @ solved[:, -1] + known @ off
                covariance = np.linalg.inv(inner)
                mean = covariance @ along
                power = at.residual @ solved[:, -1] + off @ known @ off - along @ mean
                volume = np.linalg.slogdet(v)[1] + np.linalg.slogdet(inner)[1]
                prior = -0.5 * (np.log(f) / PRIOR.spread) ** 2
                for s in (a, b):
                    prior += np.log(s) - np.log1p((s / PRIOR.setting) ** 2)
                logs.append(prior - 0.5 * (volume + power))
                means.append(mean)
                covariances.append(covariance)
    weight = np.exp(np.array(logs) - max(logs))
    weight /= weight.sum()
    mean = weight @ means
    away = np.array(means) - mean
    whole = np.einsum("m,mpq->pq", weight, covariances) + (away * weight[:, None]).T @ away
    sd = np.sqrt(np.diag(whole))
    assert np.abs(mean / sd).max() < 0.15
    np.testing.assert_allclose(np.sqrt(np.diag(got.covariance)), sd, rtol=0.12)
