"""The covariance of overlapping variances against many drawn series."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from imucalib.arrays import Array, Index
from imucalib.estimators.allan import covariance_forms, draws, freedom_of, shapes

N, DRAWN = 600, 3000
TAU = np.array([1, 2, 4, 8, 16, 32, 64])


def variances(y: Array, samples: Index = TAU) -> Array:
    """(M, draws) by definition, at every overlap, of series (n, draws)."""
    x = np.concatenate([np.zeros((1, y.shape[1])), np.cumsum(y, axis=0)])
    second = [(x[2 * m :] - 2.0 * x[m:-m] + x[: -2 * m]) / m for m in samples]
    return np.array([0.5 * np.mean(d**2, axis=0) for d in second])


@pytest.mark.parametrize(
    ("term", "make", "first"),
    [
        ("quantisation", lambda w: np.diff(w, axis=0), 0),
        ("white", lambda w: w[1:], 0),
        # A walk that steps once a sample is continuous from eight of them on.
        ("walk", lambda w: np.cumsum(w[1:], axis=0), 3),
    ],
)
def test_variances_scatter_together_as_stated(
    term: str, make: Callable[[Array], Array], first: int
) -> None:
    drawn = variances(make(np.random.default_rng(4).normal(size=(N + 1, DRAWN))))[first:]
    k = ["quantisation", "white", "instability", "walk", "ramp"].index(term)
    stated = covariance_forms(TAU[first:], np.array([N]), 1.0)[k, k]
    mean = shapes(TAU[first:].astype(float))[:, k]
    np.testing.assert_allclose(drawn.mean(axis=1), mean, rtol=0.05)
    seen = np.cov(drawn)
    np.testing.assert_allclose(np.diag(seen), np.diag(stated), rtol=0.15)
    scale = np.sqrt(np.outer(np.diag(stated), np.diag(stated)))
    np.testing.assert_allclose(seen / scale, stated / scale, atol=0.08)


def test_stretches_add_as_if_each_were_alone() -> None:
    one, two, both = (covariance_forms(TAU, np.array(n), 0.01) for n in ([N], [N, N], [N, N, N]))
    np.testing.assert_allclose(two, one / 2.0)
    np.testing.assert_allclose(both, one / 3.0)


def test_the_posterior_has_the_freedom_of_white_noise() -> None:
    """Its spread is what the whole series tells: sd of log N is 1 / sqrt(2 n), hardly more."""
    y = np.random.default_rng(8).normal(size=(20_000, 1))
    forms = covariance_forms(TAU, np.array([20_000]), 1.0)
    found = draws(TAU, variances(y)[:, 0], forms, 1.0, rng=np.random.default_rng(1))
    spread = 0.5 * np.std(found[:, 1])
    assert 1.0 < spread * np.sqrt(2.0 * 20_000) < 2.0
    assert np.all(np.diff(freedom_of(np.array([0.0, 1.0, 0.0, 0.0, 0.0]), TAU * 1.0, forms)) < 0.0)


def test_a_scatter_that_is_not_there_widens_nothing() -> None:
    """Where hours make variances sharper than any filter bends them."""
    n, samples = 500_000, 2 ** np.arange(15)
    found = draws(
        samples,
        variances(np.random.default_rng(8).normal(size=(n, 1)), samples)[:, 0],
        covariance_forms(samples, np.array([n]), 1.0),
        1.0,
        rng=np.random.default_rng(1),
    )
    assert 1.0 < 0.5 * np.std(found[:, 1]) * np.sqrt(2.0 * n) < 1.3
