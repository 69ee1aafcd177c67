"""Candidates beside a base: the same products as the whole Gram matrix, and noise that has them."""

from __future__ import annotations

from functools import partial

import numpy as np

from imucalib.arrays import Array
from imucalib.estimators.array.bordered import bordered, each_beside, noise_products
from imucalib.estimators.array.gram import Columns, gram
from imucalib.estimators.array.reduced import reduced
from imucalib.estimators.array.samples import Readings, Sampled, Weights, fit_samples
from imucalib.estimators.contest import Contest, best_of_null, directions_of
from worlds.array import corners, skew


def sampled(t: int, rng: np.random.Generator) -> Sampled:
    """The fitted motion of four IMUs, each sample of which weighs differently."""
    r = corners(4)
    w, spin = rng.normal(size=(t, 3)) * 15.0, rng.normal(size=(t, 3)) * 300.0
    y = np.einsum("tij,kj->tki", skew(w) @ skew(w) + skew(spin), r) + rng.normal(size=(t, 4, 3))
    g = w[:, None] + rng.normal(size=(t, 4, 3)) * 0.01
    weights = Weights(rng.uniform(50.0, 150.0, (t, 4)), rng.uniform(5e3, 2e4, (t, 4)))
    return fit_samples(Readings(y, g), weights, r, w)


def blocks(t: int, rng: np.random.Generator) -> tuple[list[Columns], list[Columns]]:
    """A base and candidates: of each triad and shared, of both kinds of sensor, unordered."""

    def some(width: int, gyro: bool, shared: bool) -> Columns:
        return Columns(rng.normal(size=(4, t, 3, width)) * (0.01 if gyro else 0.1), gyro, shared)

    base = [some(2, False, False), some(1, True, True), some(1, True, False)]
    return base, [some(1, True, False), some(2, False, True), some(2, False, False)]


def test_the_products_are_those_of_the_whole_matrix() -> None:
    rng = np.random.default_rng(3)
    t = 30
    found, (base, beside) = sampled(t, rng), blocks(t, rng)
    rows = np.arange(2, t)
    whole, part = gram(found, [*base, *beside], rows), bordered(found, base, beside, rows)
    b = len(part.base.matrix)
    np.testing.assert_allclose(part.base.matrix, whole.matrix[:b, :b], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(part.across, whole.matrix[:b, b:], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose([*part.base.along, *part.along], whole.along, atol=1e-9)
    np.testing.assert_allclose([*part.base.whole, *part.whole], whole.whole, rtol=1e-9)
    assert (part.base.power, part.base.numbers) == (whole.power, whole.numbers)
    prior, pull = rng.uniform(0.0, 2.0, b), rng.normal(size=b)
    each, due = each_beside(part, prior, pull), reduced(whole, prior, pull)
    start = 0
    for own in each.own:
        at = slice(start, start + len(own))
        np.testing.assert_allclose(own, due.matrix[at, at], rtol=1e-9, atol=1e-9)
        start = at.stop
    np.testing.assert_allclose(each.along, due.along, atol=1e-9)
    np.testing.assert_allclose(each.base.carry(3), due.carry[:3], atol=1e-12)
    assert np.isclose(each.power, due.power, rtol=1e-12)


def test_simulated_noise_has_the_columns_covariance() -> None:
    """Base and what is believed of it taken out: by the whole matrix and 4000 data sets."""
    rng = np.random.default_rng(5)
    t = 12
    found, (base, beside) = sampled(t, rng), blocks(t, rng)
    rows = np.arange(t)
    part = bordered(found, base, beside, rows)
    b = len(part.base.matrix)
    prior = np.where(np.arange(b) % 2, 0.5 * np.diag(part.base.matrix), 0.0)
    each = each_beside(part, prior, np.zeros(b))
    raw, power = noise_products(found, [*base, *beside], rows, rng, 4000)
    along, power = each.base.out_of_noise(raw[:b], raw[b:], power, rng)
    due = reduced(gram(found, [*base, *beside], rows), prior, np.zeros(b)).matrix
    size = np.sqrt(np.diag(due))
    off = (np.cov(along) - due) / np.outer(size, size)
    assert np.abs(off).max() < 5.0 * np.sqrt(2.0 / 4000)
    freedom = part.base.numbers - b + np.count_nonzero(prior)
    assert abs(power.mean() / freedom - 1.0) < 5.0 * np.sqrt(2.0 / freedom / 4000)


def test_chance_stays_below_what_is_beyond_it() -> None:
    """The share of data sets whose best evidence reaches x is below the bound that `beyond_chance`
    stands on, so that above it none has to be simulated."""
    rng = np.random.default_rng(7)
    columns = rng.normal(size=(200, 12))
    blocks = [np.arange(3 * k, 3 * k + 3) for k in range(4)]
    size, turns = directions_of([columns[:, at].T @ columns[:, at] for at in blocks])
    contest = Contest(blocks, size, turns, 200, 10.0 ** np.arange(-3.0, 1.1, 0.5))

    def null(count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        white = rng.standard_normal((200, count))
        return columns.T @ white, np.sum(white**2, axis=0)

    best = best_of_null(contest, partial(null, rng=rng), 3000)
    for x in (1.0, 2.0, 3.0):
        assert np.mean(best >= x) < 4 * len(contest.tau) * np.exp(-x)
    assert best.max() < contest.beyond_chance(3000)
    assert np.isclose(contest.beyond_chance(3000), np.log(1e3 * 3000 * 9 * 4))
