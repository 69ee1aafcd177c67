"""Gyros beside each other, in motion and at rest, against the same written a second time."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.calibrators.array.gyros import Gyros, gyro_drift, relative_gyros
from imucalib.calibrators.array.moving import Moving, samples_of

Array = NDArray[np.float64]


def rates(seed: int, n: int = 400, noise: float = 0.0) -> tuple[Array, Array, Array]:
    """(n, 4, 3) readings of four gyros in one motion, their gains, whose mean is one, and ω."""
    rng = np.random.default_rng(seed)
    gain = np.eye(3) + 0.03 * rng.standard_normal((4, 3, 3))
    gain = gain @ np.linalg.inv(gain.mean(axis=0))
    w = 5.0 * rng.standard_normal((n, 3))
    off = noise * rng.standard_normal((n, 4, 3))
    return np.einsum("kij,nj->nki", gain, w) + off, gain, w


def test_gains_are_those_about_their_mean() -> None:
    read, gain, w = rates(1)
    found = relative_gyros(read, np.arange(0, 400, 3))
    np.testing.assert_allclose(found.gain.mean(axis=0), np.eye(3), atol=1e-12)
    # The mean of the corrected triads is ω where the gains' mean is one.
    np.testing.assert_allclose(found.gain, gain, atol=1e-9)
    np.testing.assert_allclose(found.mean, w, atol=1e-8)
    assert found.triads == 4
    assert found.scatter.max() < 1e-8


def test_scatter_and_covariance_are_those_of_one_triad() -> None:
    read, _, _ = rates(2, 4000, 0.01)
    found = relative_gyros(read, np.arange(4000))
    corrected = np.einsum("kij,nkj->nki", np.linalg.inv(found.gain), read)
    off = corrected - corrected.mean(axis=1, keepdims=True)
    np.testing.assert_allclose(
        found.scatter, np.sqrt(np.sum(off**2, axis=(1, 2)) / (3.0 * (4 - 1))), rtol=1e-9
    )
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), 0.01, rtol=0.03)
    assert np.abs(found.covariance[0, 1]) < 5e-6
    wild = read.copy()
    wild[::50] += 0.3 * np.random.default_rng(0).standard_normal((80, 4, 3))
    kept = relative_gyros(wild, np.arange(4000))
    np.testing.assert_allclose(np.sqrt(np.diag(kept.covariance)), 0.01, rtol=0.2)


@pytest.mark.parametrize("triads", [1, 4, 16])
def test_the_size_is_open_by_what_data_sheets_leave(triads: int) -> None:
    """Uniform within 3 %, twice, over the root of all axes."""
    plain = Gyros(np.tile(np.eye(3), (triads, 1, 1)), *(np.zeros(3),) * 3)
    assert plain.scale_sd == pytest.approx(0.06 / np.sqrt(3.0) / np.sqrt(3.0 * triads))


@pytest.mark.parametrize("order", [0, 1, 2])
def test_offsets_drift_with_the_order_that_they_need(order: int) -> None:
    rng = np.random.default_rng(order)
    t = np.array([3.0, 10.0, 21.0, 35.0, 48.0, 60.0, 90.0, 103.0])
    late = (t - 103.0) / 100.0  # -1 at the first rest, 0 at the last
    truth = rng.standard_normal((order + 1, 2, 3))
    clean = np.einsum("tp,pkj->tkj", late[:, None] ** np.arange(order + 1), truth)
    read = clean + 1e-3 * rng.standard_normal((8, 2, 3))
    found, sd = gyro_drift(read, t)
    assert found.shape == (order + 1, 2, 3)
    np.testing.assert_allclose(found, truth, atol=0.02)
    powers = late[:, None] ** np.arange(order + 1)
    rest = read - np.einsum("tp,pkj->tkj", powers, found)
    of_end = np.linalg.inv(powers.T @ powers)[0, 0]
    np.testing.assert_allclose(sd, np.sqrt(of_end * np.sum(rest**2, axis=0) / (7 - order)))


def part_of(read: Array) -> Moving:
    gyros = relative_gyros(read, np.arange(len(read)))
    force = np.random.default_rng(9).standard_normal(read.shape)
    return Moving(np.arange(float(len(read))), force, read, gyros, np.arange(len(read)), 0.01, {})


def test_the_sampler_gets_the_scatter_of_the_mean() -> None:
    """Pooled: one triad's covariance over their number; of one sample: equation (30b), with a
    thousandth of the pooled variance beside it."""
    made = part_of(rates(3, 200, 0.02)[0])
    rows, sigma = np.array([4, 90]), np.full(4, 0.1)
    pooled = samples_of(made, rows, sigma)
    covariance = made.gyros.covariance
    np.testing.assert_allclose(np.linalg.inv(pooled.rate_precision), covariance / 4.0)
    alone = samples_of(made, rows, sigma, "sample")
    level = made.levelled.rate[rows]
    own = np.array([np.cov(one.T) for one in level])
    floor = 1e-3 * np.trace(covariance) / 3.0
    np.testing.assert_allclose(
        np.linalg.inv(alone.rate_precision), own + floor * np.eye(3), rtol=1e-6
    )
    np.testing.assert_allclose(level.mean(axis=1), made.gyros.mean[rows])
