"""Numbers of the posterior against numpy and formulas written again: moments, weights, priors."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from imucalib.core.observations import NoisePrior, Observations
from imucalib.core.references import KnownVector
from imucalib.estimators.least_squares import fit
from imucalib.posterior.candidates import effects_to_search
from imucalib.posterior.closed_loop.closed import close_loop
from imucalib.posterior.closed_loop.folds import leave_folds_out
from imucalib.posterior.closed_loop.words import SelectedModel, rivals_of, select_model
from imucalib.posterior.held_out import by_folds, errors, folds_of, predict_fitted
from imucalib.posterior.odds import SIZES, SPREAD
from imucalib.posterior.search.catalogue import Component, components_of, log_size_prior, scan_of
from imucalib.posterior.search.explored import SearchedPosterior, search_posterior
from imucalib.posterior.search.noise import NoiseHypothesis, terms_of
from imucalib.posterior.search.problem import Contest, problem_of
from imucalib.posterior.search.solution import moments, solve
from imucalib.posterior.search.space import Hypothesis, Pick, Posterior
from imucalib.units import DEG, MG
from worlds.at_rest import at_rest
from worlds.bench import NINE, base_model, bench, draw, ordinary_theta


@cache
def found() -> SearchedPosterior:
    asked = effects_to_search((), (), {}, lambda effect: effect.stage == "sensor")
    return search_posterior(fit(base_model(NINE), at_rest(1, 30, bend=3.0)), asked)


def test_moments_are_those_of_the_mixture_of_normals() -> None:
    """Base flat, one block of sd 2 over the noise factor; every noise by its dense precision."""
    one = found()
    problem, grams = one.problem, one.posterior.grams
    at, n = problem.choices[0].at, len(problem.fit.at.owner)
    x, y = problem.columns[:n, [*range(problem.base), *at]], problem.columns[:n, -1]
    known = np.diag([*np.zeros(problem.base), *np.full(at.size, 0.25)])
    dof = grams.numbers - problem.base
    rows = problem.columns[n:, : problem.base]
    known[: problem.base, : problem.base] += rows.T @ rows
    means, covariances, logs = [], [], []
    for k, solve_with in enumerate(grams.solves):
        precision = solve_with(np.eye(n))
        inner = x.T @ precision @ x + known
        along = x.T @ precision @ y
        along[: problem.base] += rows.T @ problem.columns[n:, -1]
        mean = np.linalg.solve(inner, along)
        power = y @ precision @ y + np.sum(problem.columns[n:, -1] ** 2) - along @ mean
        means.append(mean)
        covariances.append(np.linalg.inv(inner) * power / dof)
        logs.append(
            grams.log_weight[k] - 0.5 * np.linalg.slogdet(inner)[1] - 0.5 * dof * np.log(power)
        )
    weight = np.exp(np.array(logs) - max(logs))
    weight /= weight.sum()
    mean = weight @ means
    away = np.array(means) - mean
    whole = np.einsum("e,epq->pq", weight, covariances) + (away * weight[:, None]).T @ away
    assert np.count_nonzero(weight > 0.02) > 1
    got = moments(problem, replace(grams, spread=np.inf), [(at, 2.0)])
    np.testing.assert_allclose(got[0], mean, rtol=1e-6)
    np.testing.assert_allclose(got[1], whole, rtol=1e-6, atol=1e-12 * np.abs(whole).max())


def test_what_is_known_of_the_noise_weighs_at_its_likeliest_value() -> None:
    """A log-normal factor about one: its density at sqrt(power / dof) multiplies Jeffreys'."""
    grams = replace(found().posterior.grams, spread=0.7)
    power, dof = np.array([20.0, 90.0]), 30.0
    factor = np.log(np.sqrt(power / dof))
    expected = -0.5 * dof * np.log(power) - factor**2 / (2.0 * 0.7**2)
    np.testing.assert_allclose(grams.log_noise(power, dof), expected)


def test_sizes_are_flat_below_the_typical_one_and_fall_above() -> None:
    prior = log_size_prior(SIZES)
    assert np.exp(prior).sum() == pytest.approx(1.0)
    np.testing.assert_allclose(prior[SIZES <= 1.0], prior[0])
    above = SIZES[SIZES > 1.0]
    fall = 0.5 * (np.log(above) / np.log(SPREAD)) ** 2
    np.testing.assert_allclose(prior[0] - prior[SIZES > 1.0], fall)


def test_a_scan_has_one_prior_in_all() -> None:
    """Tried or refined: its values share it."""
    data = bench(1, 24)
    wanted = effects_to_search((), (), {}, lambda effect: True)
    scans = [(f, scan_of(data, f)) for f in wanted.families]
    for family, scan in scans:
        if scan is not None and len(scan.members) == len(family.values(data.context)):
            assert np.exp([m.log_weight for m in scan.members]).sum() == pytest.approx(1.0)
            near = family.values(data.context)[:1]
            finer = scan_of(data, family, near)
            assert finer is not None
            assert np.exp([m.log_weight for m in finer.members]).sum() == pytest.approx(1.0)


def test_terms_of_a_free_function_fall_by_each_power_of_their_order() -> None:
    """Relative sizes of the same curve: all equal, as given, and its square."""
    data = at_rest(1, 30, bend=3.0)
    asked = effects_to_search((), (), {}, lambda effect: effect.stage == "sensor")
    every = components_of(base_model(NINE), data, asked)
    (slow,) = (c for c in every if c.name == "scale against order")
    flat, once, twice = (member.effects[0][2] for member in slow.members)
    np.testing.assert_allclose(flat, flat[0])
    assert once.min() < 0.5 * once.max()
    np.testing.assert_allclose(twice, once**2 / once.max())


def contest(*kinds: str) -> Contest:
    """Components "0", "1", ... of some kinds, without members."""
    every = tuple(Component(str(k), kind, ()) for k, kind in enumerate(kinds))  # type: ignore[arg-type]
    return Contest(components=every, choices=(), base=0)


def selected(problem: Contest, weights: dict[tuple[int, ...], float]) -> SelectedModel:
    """What is told of sets of components with these probabilities."""
    ranked = sorted(weights.items(), key=lambda one: -one[1])
    sets = tuple(Hypothesis(c, tuple(Pick(k, 1.0) for k in c), np.log(p), 0.0) for c, p in ranked)
    grams = found().posterior.grams
    return select_model(problem, Posterior(sets, np.array([p for _, p in ranked]), grams, 1.0, 0.0))


@pytest.mark.parametrize(("nothing", "told"), [(0.4, ()), (0.2, ()), (0.1, ("0",))])
def test_nothing_is_told_where_silence_costs_less(nothing: float, told: tuple[str, ...]) -> None:
    """A false claim costs five times a silence."""
    problem = contest("name")
    said = selected(problem, {(): nothing, (0,): 1.0 - nothing})
    assert tuple(problem.components[p.component].name for p in said.places) == told
    assert said.complete == pytest.approx(nothing)


def test_a_simpler_set_is_told_where_the_best_beats_it_by_chance_alone() -> None:
    problem = contest("name", "name")
    close = selected(problem, {(): 0.01, (0,): 0.2, (0, 1): 0.79})
    far = selected(problem, {(): 0.01, (0,): 0.02, (0, 1): 0.97})
    assert close.hypothesis.components == (0,)
    assert far.hypothesis.components == (0, 1)


def test_a_name_is_certain_against_all_that_has_none() -> None:
    problem = contest("name", "free")
    sure = selected(problem, {(): 0.02, (0,): 0.68, (0, 1): 0.30})
    doubted = selected(problem, {(): 0.02, (0,): 0.38, (0, 1): 0.60})
    assert [p.certain for p in sure.places] == [True]
    assert [p.certain for p in doubted.places] == [False]


@cache
def slipped() -> SearchedPosterior:
    """A bench of 24 rows whose tool slipped by a degree at the thirteenth."""
    data = bench(4, 24, exact=True)
    rng, reading = np.random.default_rng(2), data.reading.copy()
    turn = np.cross(np.eye(3), np.array([0.6, -0.8, 0.5]) * DEG)
    reading[12:, 0] += reading[12:, 0] @ turn
    data = data.set_reading(reading + 0.1 * MG * rng.normal(size=reading.shape))
    asked = effects_to_search(("slip",), (), {}, lambda effect: True)
    return search_posterior(fit(base_model(), data), asked)


def test_rivals_are_one_in_all_and_either_part_may_stand_right() -> None:
    """Without its slip, one of them foretells the first part, the other the second."""
    one = slipped()
    rivals = rivals_of(one.problem, one.posterior)
    assert sum(r.weight for r in rivals) == pytest.approx(1.0)
    likely = [r for r in rivals if r.names == rivals[0].names][:2]
    assert len(likely) == 2
    stands = []
    for rival in likely:
        data, theta = rival.fit.observations, rival.fit.theta.copy()
        for name, part in rival.fit.model.slices(data.context).items():
            if name.startswith("slip@"):
                theta[part] = 0.0
        size = errors(rival.fit, theta, data).size / MG
        stands.append((float(np.median(size[:12])), float(np.median(size[12:]))))
    (first, moved), (turned, second) = stands
    assert max(first, second) < 1.0
    assert min(moved, turned) > 5.0


def test_a_set_is_held_at_its_sizes() -> None:
    """Over the noise factor: the size that the set was found at times what each number is alone."""
    one = found()
    problem = one.problem
    k = next(j for j, c in enumerate(problem.choices) if len(c.member.effects) == 1)
    choice = problem.choices[k]
    hypothesis = Hypothesis((choice.component,), (Pick(k, 4.0),), 0.0, 0.0)
    solved = solve(problem, one.posterior.grams, hypothesis)
    effect, own, scale = choice.member.effects[0]
    part = solved.model.slices(problem.fit.observations.context)[effect.name]
    np.testing.assert_allclose(solved.shrink[part][own], 4.0 * scale)
    for name in problem.model.names:
        assert np.isinf(
            solved.shrink[solved.model.slices(problem.fit.observations.context)[name]]
        ).all()


def noises(data: Observations) -> tuple[NoiseHypothesis, ...]:
    """All that the noise of a clean bench may be."""
    base = base_model()
    one = fit(base, draw(base, ordinary_theta(base, data, 3), data, 5))
    return terms_of(problem_of(one, ())).points


def test_the_scatter_of_settings_has_a_half_cauchy_prior() -> None:
    """Half of it lies below its median, .1 deg: a hundred times a reading's noise seldom is it."""
    prior = NoisePrior(spread=0.5, setting=0.1 * DEG)
    points = noises(replace(bench(3, 24), noise_prior=prior))
    assert np.exp([p.log_prior for p in points]).sum() == pytest.approx(1.0)
    share: dict[float, float] = {}
    for point in points:
        share[point.ratio[0]] = share.get(point.ratio[0], 0.0) + float(np.exp(point.log_prior))
    ratio, mass = np.array(sorted(share.items())).T
    edges = np.sqrt(ratio[1:] * np.maximum(ratio[:-1], ratio[1:] / 9.0))
    below = 2.0 / np.pi * np.arctan(edges * fitted_factor(prior) / prior.setting)
    np.testing.assert_allclose(np.cumsum(mass)[:-1], below, rtol=1e-6)


def fitted_factor(prior: NoisePrior) -> float:
    """The noise factor of the same bench."""
    base, data = base_model(), replace(bench(3, 24), noise_prior=prior)
    return fit(base, draw(base, ordinary_theta(base, data, 3), data, 5)).noise.factor


def test_rows_in_an_order_of_work_share_settings_as_their_neighbours_do() -> None:
    """Sorted by dip and tool-face the order is that of work, in disorder nobody knows."""
    data = bench(3, 30, shared=True)
    reference = data.reference
    assert isinstance(reference, KnownVector)
    rows = np.lexsort([reference.tool_face, reference.inclination])
    mixed = np.random.default_rng(1).permutation(reference.n)
    for some, least, most in ((rows, 0.97, 0.99), (mixed, 0.2, 0.6)):
        points = noises(data.take(some))
        told = [p for p in points if any(p.ratio)]
        assert len({p.sharing for p in told}) > 1
        mass = np.exp([p.log_prior for p in told])
        own = mass[[p.sharing == 0 for p in told]].sum() / mass.sum()
        assert least < own < most


def test_a_clean_bench_is_fitted_without_a_walk() -> None:
    base, data = base_model(), bench(3, 24)
    data = draw(base, ordinary_theta(base, data, 3), data, 5)
    asked = effects_to_search(("quadratic",), (), {}, lambda effect: True)
    loop = close_loop(base, data, asked).loop
    assert not loop.steps
    assert loop.base.observations.shared == ()


def test_a_bias_that_walks_is_noise_of_the_fit() -> None:
    """2 mg that forget after eight rows: nothing is named, and readings are worth fewer."""
    base, data = base_model(), bench(3, 40)
    data = draw(base, ordinary_theta(base, data, 3), data, 5)
    near = np.exp(-np.abs(np.arange(40)[:, None] - np.arange(40)) / 8.0) + 1e-9 * np.eye(40)
    off = 2.0 * np.linalg.cholesky(near) @ np.random.default_rng(1).normal(size=(40, 3))
    asked = effects_to_search(("quadratic",), (), {}, lambda effect: True)
    loop = close_loop(base, data.set_reading(data.reading + off[:, None] * MG), asked).loop
    assert not loop.steps
    assert len(loop.base.observations.shared) == 1


def test_folds_are_predicted_as_by_refits_and_gain_what_the_whole_does() -> None:
    one = found()
    folds = folds_of(one.base.observations)
    left = leave_folds_out(one.problem, one.posterior, folds)
    literal = by_folds(one.base, folds)
    np.testing.assert_allclose(left.before.rms(), literal.rms(), rtol=0.05)
    assert left.before.rms() > 1.1 * predict_fitted(one.base).rms()
    best = one.posterior.hypotheses[0]
    whole = best.evidence - one.posterior.base.evidence
    assert whole > 10.0
    assert 0.5 * whole < left.nats.sum() < 3.0 * whole
