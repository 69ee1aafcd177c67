"""What is weighed of sizes of a scatter, against the same written once more with dense laws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag, null_space
from scipy.stats import multivariate_normal, norm

from imucalib.arrays import Array
from imucalib.estimators.power_ups import Parts, parts_of, predict_next, sizes_allowed, weigh_moved


def weights(sizes: Array, nats: Array, noise: float) -> tuple[Array, Array]:
    """Of all axes (s,) and each (k, s): the joint law of the size of all and of every axis, summed
    one by one."""
    prior = sizes / (sizes + noise)
    about = norm.pdf(np.log(sizes)[:, None], np.log(sizes), 0.5)  # size of an axis, size of all
    about /= about.sum(axis=0)
    joint = prior * np.exp(nats[..., None]).swapaxes(0, 1) * about[:, None]  # (s, k, size of all)
    sums = joint.sum(axis=0) / prior
    every = prior * np.prod(sums, axis=0)
    each = np.array([joint[:, k] @ (every / prior / sums[k]) for k in range(len(nats))])
    return every / every.sum(), each / each.sum(axis=1, keepdims=True)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("sd", [0.0, 0.3, 4.0])
def test_sizes_of_parts_are_those_of_their_marginal_law(seed: int, sd: float) -> None:
    """What is seen of the parts is normal, with what is known and what they scatter by."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((15, 12))
    information, seen = root.T @ root, rng.standard_normal(12)
    noise = np.mean(np.diag(information)) ** -0.5
    grid = np.geomspace(0.05 * noise, 30.0 * max(sd, noise), 36)
    known = np.linalg.inv(information)
    nats = np.empty((3, 36))
    for axis in range(3):
        for s, size in enumerate(grid):
            own = np.full(3, sd)
            own[axis] = size
            law = multivariate_normal(cov=known + np.diag(np.tile(own, 4) ** 2))
            nats[axis, s] = law.logpdf(seen)
    sizes, of_all, of_each = sizes_allowed(Parts(information, information @ seen), sd)
    expected = weights(grid, nats - nats.max(axis=1, keepdims=True), noise)
    assert sizes == pytest.approx(grid, rel=1e-9)
    assert of_all == pytest.approx(expected[0], rel=1e-6, abs=1e-12)
    assert of_each == pytest.approx(expected[1], rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("noise", [0.01, 1.0])
def test_the_next_one_is_the_mixture_over_the_likely_sizes(seed: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    values = 3.0 + np.array([0.5, 1.0, 2.0]) * rng.standard_normal((4, 3))
    sds = noise * np.exp(0.3 * rng.standard_normal((4, 3)))
    contrasts = null_space(np.ones((1, 4)))
    alone = np.sqrt(np.mean(sds**2))

    def nats_of(sizes: Array) -> Array:
        nats = np.empty((3, len(sizes)))
        for k in range(3):
            for s, size in enumerate(sizes):
                law = np.diag(size**2 + sds[:, k] ** 2)
                cov = contrasts.T @ law @ contrasts
                nats[k, s] = multivariate_normal(cov=cov).logpdf(contrasts.T @ values[:, k])
        return nats - nats.max(axis=1, keepdims=True)

    wide = np.geomspace(0.05 * alone, 30.0 * max(values.std(axis=0, ddof=1).max(), alone), 36)
    likely = np.flatnonzero(np.any(nats_of(wide) > -15.0, axis=0))
    ends = max(likely[0] - 1, 0), min(likely[-1] + 1, 35)
    sizes = np.geomspace(*wide[list(ends)], 72)
    _, weight = weights(sizes, nats_of(sizes), alone)
    variances = 1.0 / np.sum(1.0 / (sizes**2 + sds[..., None] ** 2), axis=0)
    means = variances * np.sum(values[..., None] / (sizes**2 + sds[..., None] ** 2), axis=0)
    said = predict_next(values, sds)
    assert said.size == pytest.approx(sizes, rel=1e-9)
    assert said.weight == pytest.approx(weight, rel=1e-6, abs=1e-12)
    assert said.mean == pytest.approx(np.sum(weight * means, axis=1), rel=1e-6)
    away = variances + (means - said.mean[:, None]) ** 2 + sizes**2
    assert said.sd == pytest.approx(np.sqrt(np.sum(weight * away, axis=1)), rel=1e-6)
    far = 2.0 * norm.sf(np.abs(values[0][:, None] - means), 0.0, np.sqrt(variances + sizes**2))
    assert said.chance(values[0], np.zeros(3)) == pytest.approx(np.sum(weight * far, axis=1))


def products(seed: int) -> tuple[Array, Array]:
    """Of four recordings, six parameters each."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((4, 9, 6))
    information = root.swapaxes(1, 2) @ root
    return information, (information @ rng.standard_normal((4, 6, 1)))[..., 0]


def test_what_no_recording_tells_takes_nothing_from_the_parts() -> None:
    information, vector = products(1)
    information[:, 5] = information[:, :, 5] = vector[:, 5] = 0.0
    told = information[:, :5, :5], vector[:, :5]
    for free in (np.arange(0), np.array([0])):
        with_it = parts_of(information, vector, np.array([2, 3]), free)
        without = parts_of(*told, np.array([2, 3]), free)
        assert with_it.information == pytest.approx(without.information, rel=1e-9, abs=1e-12)
        assert with_it.vector == pytest.approx(without.vector, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_what_moved_is_weighed_by_the_marginal_law_of_all_recordings(seed: int) -> None:
    """What each recording has found is normal. A free parameter is left out of it; the differences
    of recordings hold nothing of what all share."""
    information, vector = products(seed)
    known = np.linalg.inv(information)[:, 1:, 1:]
    seen = np.linalg.solve(information, vector[..., None])[:, 1:, 0].ravel()
    contrasts = np.kron(null_space(np.ones((1, 4))), np.eye(5))
    typical = np.linspace(0.1, 0.6, 6)
    blocks = {"a": np.array([1, 2]), "b": np.array([3, 4, 5])}

    def nats(block: list[int], size: float) -> float:
        own = np.zeros(6)
        own[block] = (size * typical[block]) ** 2
        cov = contrasts.T @ (block_diag(*known) + np.diag(np.tile(own[1:], 4))) @ contrasts
        return float(multivariate_normal(cov=cov).logpdf(contrasts.T @ seen))

    none, sets = nats([], 0.0), ([1, 2], [3, 4, 5], [1, 2, 3, 4, 5])
    odds = [
        0.2 / 3.0 / 9.0 * sum(np.exp(nats(one, 2.0**n) - none) for n in range(-2, 7))
        for one in sets
    ]
    share = np.array(odds) / (1.0 + sum(odds))
    probability, each = weigh_moved(information, vector, blocks, typical, np.array([0]))
    assert probability == pytest.approx(share.sum(), rel=1e-6)
    assert each["a"] == pytest.approx(share[0] + share[2], rel=1e-6)
    assert each["b"] == pytest.approx(share[1] + share[2], rel=1e-6)
