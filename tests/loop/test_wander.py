"""The walk's linear algebra against dense matrices, and what the search makes of wandering data."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from gates.bounds import at_most
from imucalib.core.model import Model
from imucalib.effects import named
from imucalib.loop.design import Fold
from imucalib.loop.wander.bank import Bank, bank_of, parts_of, splits_of, walks_of
from imucalib.loop.wander.chance import null_of
from imucalib.loop.wander.choice import Rules, search
from imucalib.loop.wander.engine import _nearest
from imucalib.loop.wander.final import fitted
from imucalib.loop.wander.held_blocks import judged, solved
from imucalib.loop.wander.likelihood import Terms, best_level, levels
from imucalib.loop.wander.noise import Noise
from imucalib.loop.wander.scores import SIZES, Entry, Scored, middle_of_best, scored
from imucalib.loop.wander.walk import Course, Walk, beside, correlated, drawn, weighted, whitened
from imucalib.units import MG
from worlds.bench import GRAVITY, draw, tumble

Array = NDArray[np.float64]
WALKS = (Walk(0.0, 1.0), Walk(0.4, 900.0), Walk(6.0, 20000.0))


def course(n: int = 60, q: int = 3, seed: int = 0, parts: int = 4) -> Course:
    rng = np.random.default_rng(seed)
    time = np.sort(rng.uniform(0.0, 40000.0, n))
    part = np.minimum(np.arange(n) * parts // n, parts - 1).astype(np.intp)
    return Course(time, rng.standard_normal((n, q)), rng.uniform(0.5, 3.0, n), part)


def dense(at: Course, walk: Walk) -> Array:
    """V as the page prints it, the walk anew in every part."""
    lag = np.abs(at.time[:, None] - at.time)
    same = at.part[:, None] == at.part
    shared = walk.rho * np.exp(-lag / walk.tau) * same * (at.seen @ at.seen.T)
    return np.diag(at.variance) + shared


@pytest.mark.parametrize("walk", WALKS)
def test_the_filter_is_the_dense_inverse(walk: Walk) -> None:
    at = course()
    z = np.random.default_rng(1).standard_normal((60, 5))
    white, log_det = whitened(at, (walk,), z)
    single, _ = whitened(at, (walk,), z.astype(np.float32))
    assert single.dtype == np.float32
    assert np.allclose(single, white, atol=1e-5)
    v = dense(at, walk)
    assert np.allclose(white[0].T @ white[0], z.T @ np.linalg.solve(v, z), rtol=1e-9, atol=1e-9)
    assert log_det.sum() == pytest.approx(np.linalg.slogdet(v)[1], abs=1e-9)
    for part in range(4):
        rows = np.flatnonzero(at.part == part)
        own = v[np.ix_(rows, rows)]
        gram = white[0][rows].T @ white[0][rows]
        assert np.allclose(gram, z[rows].T @ np.linalg.solve(own, z[rows]), rtol=1e-9, atol=1e-9)
        assert log_det[0, part] == pytest.approx(np.linalg.slogdet(own)[1], abs=1e-9)


def test_a_large_slow_walk_stays_exact_through_a_long_recording() -> None:
    """What neighbours do not share is thousands of times smaller than what they do."""
    n, walk = 1500, Walk(3000.0, 2.0 * 86400.0)
    rng = np.random.default_rng(3)
    seen = rng.standard_normal((n, 4))
    seen[:, 3] = np.linalg.norm(seen[:, :3], axis=1)
    time = np.sort(rng.uniform(0.0, 86400.0, n))
    at = Course(time, seen, np.ones(n), np.zeros(n, np.intp))
    white, log_det = whitened(at, (walk,), np.eye(n)[:, :3])
    v = dense(at, walk)
    assert np.allclose(white[0].T @ white[0], np.linalg.inv(v)[:3, :3], rtol=1e-6, atol=1e-9)
    assert log_det[0, 0] == pytest.approx(np.linalg.slogdet(v)[1], rel=1e-9)


def test_several_walks_at_once_are_each_alone() -> None:
    at = course(parts=7)
    z = np.random.default_rng(2).standard_normal((60, 3))
    together, log_det = whitened(at, WALKS, z)
    for k, walk in enumerate(WALKS):
        alone, own = whitened(at, (walk,), z)
        assert np.allclose(together[k], alone[0], rtol=0.0, atol=1e-12)
        assert np.allclose(log_det[k], own[0], rtol=0.0, atol=1e-12)


def test_what_is_left_beside_the_smoothed_walk() -> None:
    at, walk = course(parts=1), WALKS[1]
    residual = np.random.default_rng(3).standard_normal(60)
    v = dense(at, walk)
    smoothed = (v - np.diag(at.variance)) @ np.linalg.solve(v, residual)
    assert np.allclose(beside(at, walk, residual), residual - smoothed, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("walk", WALKS)
def test_columns_by_the_covariance_and_by_its_inverse_are_the_dense_ones(walk: Walk) -> None:
    """V without borders between parts; V⁻¹ with the walk anew in every part."""
    at = course()
    columns = np.random.default_rng(3).standard_normal((60, 4))
    lag = np.abs(at.time[:, None] - at.time)
    whole = np.diag(at.variance) + walk.rho * np.exp(-lag / walk.tau) * (at.seen @ at.seen.T)
    np.testing.assert_allclose(correlated(at, walk, columns), whole @ columns, rtol=1e-9, atol=1e-9)
    inverse = np.linalg.solve(dense(at, walk), columns)
    np.testing.assert_allclose(weighted(at, walk, columns), inverse, rtol=1e-9, atol=1e-9)


def test_drawn_noise_has_the_covariance_without_borders() -> None:
    at, walk = course(n=12, parts=3), Walk(2.0, 8000.0)
    data = drawn(at, walk, np.random.default_rng(4), 40000)
    whole = dense(Course(at.time, at.seen, at.variance, np.zeros(12, np.intp)), walk)
    scale = np.sqrt(np.outer(np.diag(whole), np.diag(whole)))
    assert np.abs((data @ data.T / 40000 - whole) / scale).max() < 0.03


def made(seed: int = 5, n: int = 90) -> tuple[Bank, Terms, tuple[Fold, ...], Array]:
    """A bank of three base columns, four candidate columns and the data, in three blocks."""
    rng = np.random.default_rng(seed)
    block = np.arange(n) * 3 // n
    every = np.arange(n)
    folds = tuple(
        Fold(every[block == k], every[(every < 30 * k - 3) | (every >= 30 * k + 33)])
        for k in range(3)
    )
    part = parts_of(folds, n)
    at = course(n, seed=seed)
    at = Course(at.time, at.seen, at.variance, part)
    columns = rng.standard_normal((n, 8))
    return bank_of(at, WALKS, columns), Terms(np.arange(3), np.ones(3), 3), folds, columns


def test_parts_add_up_to_folds() -> None:
    bank, _, folds, columns = made()
    splits = splits_of(folds, bank.course.part)
    for fold, split in zip(folds, splits, strict=True):
        assert np.array_equal(np.flatnonzero(split.test[bank.course.part]), fold.rows)
        assert np.array_equal(np.flatnonzero(split.train[bank.course.part]), fold.rest)
        for k, walk in enumerate(WALKS):
            v = dense(bank.course, walk)[np.ix_(fold.rest, fold.rest)]
            direct = columns[fold.rest].T @ np.linalg.solve(v, columns[fold.rest])
            whole, out = bank.over(k, split.train)
            assert np.allclose(whole - out.T @ out, direct, rtol=1e-9, atol=1e-9)
            summed = bank.by_part(k, np.arange(8))[split.train].sum(axis=0)
            assert np.allclose(summed, direct, rtol=1e-9, atol=1e-9)


def test_products_that_are_kept_are_those_of_the_columns() -> None:
    """Whatever was made before: of fewer walks, of fewer columns, or of more."""
    bank, terms, folds, columns = made()
    split = splits_of(folds, bank.course.part)[1]
    fewer = bank.under(WALKS[-1:])
    assert fewer.walks == (WALKS[0], WALKS[-1])
    some = np.array([0, 1, 2, bank.data])
    fewer.over(1, np.ones_like(split.train))
    fewer.products(some, split.train)
    fewer.by_part(1, some)
    new = columns[:, :2] * columns[:, 4:6]
    more = fewer.plus(new)
    picked = np.array([2, 0, 8, 9, more.data])
    fresh = bank_of(bank.course, fewer.walks, np.column_stack([columns, new])[:, picked])
    for own, at in ((more, picked), (more.only(picked), np.arange(5))):
        assert np.allclose(own.products(at, split.train), fresh.products(np.arange(5), split.train))
        assert np.allclose(own.by_part(1, at), fresh.by_part(1, np.arange(5)))
    here, there = (levels(b, terms, split.train) for b in (fewer, bank))
    assert [x.nats for x in here] == pytest.approx([there[0].nats, there[-1].nats])
    moved = more.only(np.array([2, 1, 0, more.data]))
    order = np.array([2, 1, 0, 3])
    whole = fewer.products(some, split.train)[:, order[:, None], order]
    assert np.allclose(moved.products(np.arange(4), split.train), whole)


def marginal(x: Array, y: Array, v: Array, sd: Array, freedom: int) -> float:
    """The likelihood of y with normal parameters of these sd, s² profiled, from n by n matrices."""
    whole = v + (x * sd**2) @ x.T
    rest = float(y @ np.linalg.solve(whole, y))
    return float(-0.5 * (np.linalg.slogdet(whole)[1] + freedom * np.log(rest / freedom)))


def test_the_likelihood_is_the_dense_one() -> None:
    bank, terms, _, columns = made()
    keep = np.ones(bank.course.parts, dtype=bool)
    with_one = terms.plus(np.array([3, 4]), 0.5)
    sd = np.array([1.0, 1.0, 1.0, 0.5, 0.5])
    for level in levels(bank, with_one, keep):
        v = dense(bank.course, WALKS[level.walk])
        nats = marginal(columns[:, :5], columns[:, 7], v, sd, 87)
        assert level.nats == pytest.approx(nats, abs=1e-9)


def test_evidence_is_the_gain_of_the_dense_likelihood() -> None:
    bank, terms, _, columns = made()
    keep = np.ones(bank.course.parts, dtype=bool)
    entries = [Entry("a", "", "shape", np.array([3, 4])), Entry("b", "", "shape", np.array([5]))]
    found, _ = scored(bank, terms, keep, entries, (0, 1, 2))
    quick, _ = scored(bank, terms, keep, entries, (0, 1, 2), told=False)
    assert [s.entry for s in quick] == [s.entry for s in found]
    assert [s.evidence for s in quick] == pytest.approx([s.evidence for s in found], abs=1e-9)
    assert [(s.walk, s.size) for s in quick] == [(s.walk, s.size) for s in found]
    variance = [dense(bank.course, walk) for walk in WALKS]
    y = columns[:, 7]
    without = max(marginal(columns[:, :3], y, v, np.ones(3), 87) for v in variance)
    for one in found:
        x = columns[:, [0, 1, 2, *one.entry.columns]]
        best = max(
            marginal(x, y, v, np.array([1.0] * 3 + [size] * one.entry.columns.size), 87)
            for v in variance
            for size in SIZES
        )
        assert one.evidence == pytest.approx(max(best - without, 0.0), abs=1e-9)


def test_held_out_density_is_the_conditional_one() -> None:
    bank, terms, folds, columns = made()
    splits = splits_of(folds, bank.course.part)
    found = judged(bank, terms, 1, splits)
    v = dense(bank.course, WALKS[1])
    x, y = columns[:, :3], columns[:, 7]
    for k, fold in enumerate(folds):
        a, b = fold.rest, fold.rows
        gram = x[a].T @ np.linalg.solve(v[np.ix_(a, a)], x[a]) + np.eye(3)
        theta = np.linalg.solve(gram, x[a].T @ np.linalg.solve(v[np.ix_(a, a)], y[a]))
        assert np.allclose(solved(bank, terms, 1, splits[k].train), theta, rtol=0.0, atol=1e-9)
        whole = v[np.ix_(a, a)] + x[a] @ x[a].T
        s2 = float(y[a] @ np.linalg.solve(whole, y[a])) / (a.size - 3)
        spread = s2 * (v[np.ix_(b, b)] + x[b] @ np.linalg.solve(gram, x[b].T))
        left = y[b] - x[b] @ theta
        nats = -0.5 * (np.linalg.slogdet(spread)[1] + left @ np.linalg.solve(spread, left))
        assert found.nats[k] == pytest.approx(nats, abs=1e-8)
        assert found.error()[k] == pytest.approx(np.mean(np.abs(left)), abs=1e-9)


def test_a_walk_longer_than_a_sixth_of_the_recording_is_no_noise() -> None:
    time = np.linspace(0.0, 86400.0, 500)
    walks = walks_of(time)
    assert walks[0].rho == 0.0
    assert max(walk.tau for walk in walks) == pytest.approx(14400.0)
    assert min(walk.tau for walk in walks[1:]) > 180.0


def test_noise_takes_no_effects_place_and_no_effect_the_noises() -> None:
    """The best of ten empty candidates passes the bar at its rate; a strong one always does."""
    passed = hit = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        n = 240
        block = np.arange(n) * 8 // n
        every = np.arange(n)
        folds = tuple(Fold(every[block == k], every[block != k]) for k in range(8))
        time = np.sort(rng.uniform(0.0, 86400.0, n))
        at = Course(time, np.ones((n, 1)), np.ones(n), parts_of(folds, n))
        noise = drawn(at, Walk(2.0, 5000.0), rng, 1)
        x = np.column_stack([np.ones(n), rng.standard_normal((n, 10))])
        keep = np.ones(8, dtype=bool)
        terms = Terms(np.array([0]), np.array([1e-2]), 1)
        entries = [Entry(f"e{k}", "", f"kind {k}", np.array([k])) for k in range(1, 11)]
        for planted in (0.0, 0.9):
            y = noise + planted * x[:, 1:2]
            bank = bank_of(at, walks_of(time), np.column_stack([x, y]))
            null = null_of(bank, levels(bank, terms, keep), rng, 100, range(len(bank.walks)))
            walk = best_level(bank, terms, keep)
            _, chance = scored(bank, terms, keep, entries, range(len(bank.walks)), null)
            nats = np.quantile(chance, 0.95, axis=1)
            rules = Rules(lambda *_, nats=nats: (nats,), 3, lambda entry: (), lambda _: ())
            found = search(bank, terms, entries, splits_of(folds, at.part), keep, rules)
            assert walk.walk > 0
            if planted:
                hit += found.taken[:1] != () and found.taken[0].found.entry.name == "e1"
            else:
                passed += bool(found.taken)
    assert hit == 40
    assert passed <= at_most(40, 0.05).most


def test_chance_is_asked_for_only_where_what_is_sure_does_not_hold_out() -> None:
    """A lower bar is drawn once nothing that reaches the higher one is taken."""
    rng = np.random.default_rng(3)
    n, every = 160, np.arange(160)
    folds = tuple(Fold(every[every // 20 == k], every[every // 20 != k]) for k in range(8))
    time = np.sort(rng.uniform(0.0, 86400.0, n))
    at = Course(time, np.ones((n, 1)), np.ones(n), parts_of(folds, n))
    x = np.column_stack([np.ones(n), rng.standard_normal((n, 2))])
    y = x @ np.array([0.0, 3.0, 0.6]) + rng.standard_normal(n)
    bank, keep = bank_of(at, walks_of(time)[:3], np.column_stack([x, y])), np.ones(8, dtype=bool)
    entries = [Entry(f"e{k}", "", f"kind {k}", np.array([k])) for k in (1, 2)]
    asked = list[tuple[int, str]]()

    def bars(_: Bank, __: Terms, turn: int, scores: Sequence[Scored]) -> Iterator[Array]:
        for name, nats in (("sure", 40.0), ("drawn", 3.0)):
            asked.append((turn, name))
            yield np.full(2, nats)

    rules = Rules(bars, 3, lambda entry: (), lambda _: ())
    terms = Terms(np.array([0]), np.array([1e-2]), 1)
    found = search(bank, terms, entries, splits_of(folds, at.part), keep, rules)
    assert [t.found.entry.name for t in found.taken] == ["e1", "e2"]
    assert asked == [(0, "sure"), (1, "sure"), (1, "drawn")]


def test_a_round_without_drawn_data_has_those_of_the_next() -> None:
    drawn = {1: np.array([1.0]), 3: np.array([3.0])}
    assert [float(_nearest(drawn, turn)[0]) for turn in range(5)] == [1.0, 1.0, 3.0, 3.0, 3.0]


@pytest.mark.parametrize("share", [0.2, 1.0, 5.0])
def test_a_prior_pulls_as_strongly_as_it_says(share: float) -> None:
    """Biases of a few mg seen by norms are a linear model: |r| - g = u'b. A prior of `share` times
    what the rows know of a bias gives ridge regression's answer and covariance."""
    model, scatter = Model((named("bias"),)), 5.0
    data = draw(model, np.array([3.0, -4.0, 2.0]), tumble(3), 1)
    r = data.reading[:, 0]
    n, size = len(r), np.linalg.norm(r, axis=1)
    none = Course(np.arange(float(n)), np.zeros((n, 4)), np.ones(n), np.zeros(n, np.intp))
    noise = Noise(scatter, none, Walk(0.0, 1.0), 0.0, 0.0, 0, ())
    typical = np.array([p.typical for p in model.parameters(data.context)])
    assert (typical != 1.0).all()
    weight = share * n / 3.0 / scatter**2
    found = fitted(model, data, noise, np.zeros(3), weight * typical**2)
    u, off = r / size[:, None], (size - GRAVITY) / MG
    information = u.T @ u / scatter**2 + weight * np.eye(3)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(information), rtol=0.02, atol=1e-3)
    expected = np.linalg.solve(information, u.T @ off / scatter**2)
    np.testing.assert_allclose(found.theta, expected, atol=0.02)


def test_columns_of_two_searches_stay_apart() -> None:
    """Searches without one block each add a value of a scan of their own behind the same bank."""
    bank, _, _, columns = made()
    rng, at = np.random.default_rng(9), np.array([0, 8, 7])
    for more in (rng.standard_normal((90, 1)), rng.standard_normal((90, 1))):
        own, every = bank.plus(more), np.column_stack([columns, more])[:, at]
        direct = every.T @ np.linalg.solve(dense(bank.course, WALKS[1]), every)
        assert np.allclose(own.by_part(1, at).sum(axis=0), direct, rtol=1e-9, atol=1e-9)


def test_of_moments_that_no_row_tells_apart_the_middle_is_taken() -> None:
    nats = np.array([2.0, 7.0 + 1e-12, 7.0, 7.0 - 1e-12, 3.0])
    assert middle_of_best(nats) == middle_of_best(nats[::-1]) == 2
