"""The posterior over what is missing against a slow integration: numpy, dense matrices, a grid of
noise factors, no algebra of the program's.

    y ~ N(X b + Σ_c C_c u_c, s² V_e),  u_c ~ N(0, τ² s²),  b flat, d log s flat, prior of τ s and e
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.posterior.held_out import difference
from imucalib.posterior.odds import KNOWN, MISSING, SIZES, SPREAD
from imucalib.posterior.search.catalogue import Component, Member
from imucalib.posterior.search.gram import Grams, Weighted
from imucalib.posterior.search.problem import Choice, Contest
from imucalib.posterior.search.solution import moments, noises_of
from imucalib.posterior.search.space import Posterior, blocks_of, search

N, BASE = 40, 3
#: Columns of the members of two components, and the weights of the members.
MEMBERS = (((3, 4), 0.6, 0), ((5,), 0.4, 0), ((6,), 1.0, 1))
NOISES = (0.7, 0.3)
FACTORS = np.geomspace(0.2, 5.0, 240)


def world(seed: int) -> tuple[Array, list[Array]]:
    """(N, 8) base, members, y; and the noises: rows by themselves, and neighbours alike."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(N, 8))
    columns[:, 0] = 1.0
    apart = np.abs(np.arange(N)[:, None] - np.arange(N))
    noises = [np.eye(N), np.eye(N) + 2.0 * np.exp(-apart / 5.0)]
    e = np.linalg.cholesky(noises[seed % 2]) @ rng.normal(size=N)
    columns[:, 7] = columns[:, :3] @ [3.0, -1.0, 2.0] + 0.5 * columns[:, 3] + e
    return columns, noises


def posterior_of(columns: Array, noises: list[Array]) -> tuple[Contest, Posterior]:
    members = [Member((), float(np.log(weight))) for _, weight, _ in MEMBERS]
    contest = Contest(
        components=(
            Component("one", "name", tuple(members[:2])),
            Component("other", "name", tuple(members[2:])),
        ),
        choices=tuple(
            Choice(component, member, np.array(at), member.log_weight)
            for member, (at, _, component) in zip(members, MEMBERS, strict=True)
        ),
        base=BASE,
    )
    solves = tuple(partial(np.linalg.solve, v) for v in noises)
    logs = [np.log(p) - 0.5 * np.linalg.slogdet(v)[1] for p, v in zip(NOISES, noises, strict=True)]
    grams = Grams(
        products=Weighted(columns, solves, np.zeros((0, 8))),
        removed=np.zeros((2, 0, 8)),
        log_weight=np.array(logs),
        numbers=float(N),
        points=(0, 1),
        spread=np.inf,
    )
    return contest, search(contest, grams)


def densities(columns: Array, noise: Array, blocks: list[tuple[tuple[int, ...], float]]) -> Array:
    """(S,) log density of what the base leaves of y at every noise factor."""
    off = np.linalg.qr(columns[:, :BASE], mode="complete")[0][:, BASE:].T
    own = noise + sum(t**2 * columns[:, at] @ columns[:, at].T for at, t in blocks)
    left, inside = off @ columns[:, 7], off @ own @ off.T
    power = left @ np.linalg.solve(inside, left)
    size = left.size * np.log(FACTORS**2) + np.linalg.slogdet(inside)[1]
    return np.asarray(-0.5 * (size + power / FACTORS**2))


def size_priors(factor: float) -> Array:
    over = np.maximum(np.log(SIZES * factor), 0.0) / np.log(SPREAD)
    return np.asarray(-0.5 * over**2 - np.log(np.exp(-0.5 * over**2).sum()))


def evidence(columns: Array, noises: list[Array], which: tuple[int, ...]) -> float:
    """Of a set of components, by adding everything up."""
    prior = np.array([size_priors(s) for s in FACTORS])
    terms = [([], np.zeros(FACTORS.size))]
    for component in which:
        terms = [
            ([*blocks, (at, tau)], logs + np.log(weight) + prior[:, k])
            for blocks, logs in terms
            for at, weight, owner in MEMBERS
            if owner == component
            for k, tau in enumerate(SIZES)
        ]
    every = [
        np.log(p) + logs + densities(columns, noise, blocks)
        for p, noise in zip(NOISES, noises, strict=True)
        for blocks, logs in terms
    ]
    return float(np.logaddexp.reduce(np.concatenate(every)))


@pytest.mark.parametrize("seed", range(6))
def test_probabilities_are_those_of_the_integral(seed: int) -> None:
    columns, noises = world(seed)
    _, found = posterior_of(columns, noises)
    sets = ((), (0,), (1,), (0, 1))
    prior = [0.0, *2 * (np.log(MISSING * KNOWN / 2),), np.log(MISSING * (KNOWN / 2) ** 2)]
    logs = np.array([evidence(columns, noises, one) for one in sets]) + prior
    expected = np.exp(logs - np.logaddexp.reduce(logs))
    told = {h.components: p for h, p in found.weighed}
    np.testing.assert_allclose([told[one] for one in sets], expected, atol=0.02)


@pytest.mark.parametrize("seed", range(4))
def test_noises_and_parameters_are_those_of_the_integral(seed: int) -> None:
    """Weights of the noises, mean and covariance of base and members beside the likeliest set of
    one component, by the joint normal of everything at every noise and noise factor."""
    columns, noises = world(seed)
    contest, found = posterior_of(columns, noises)
    pick = next(h for h in found.hypotheses if h.components == (0,)).picks
    ((at, size),) = blocks_of(contest.choices, pick)
    used = [*range(BASE), *map(int, at)]
    design, y = columns[:, used], columns[:, 7]
    prior = np.diag([0.0] * BASE + [size**-2.0] * at.size)
    weights, means, spreads = [], [], []
    for p, noise in zip(NOISES, noises, strict=True):
        logs = np.log(p) + densities(columns, noise, [(tuple(map(int, at)), size)])
        inner = np.linalg.inv(design.T @ np.linalg.solve(noise, design) + prior)
        weights.append(np.exp(logs))
        means.append(inner @ design.T @ np.linalg.solve(noise, y))
        spreads.append(inner)
    weight = np.array([w.sum() for w in weights])
    square = [float(w @ FACTORS**2 / w.sum()) for w in weights]
    weight /= weight.sum()
    mean = weight @ np.array(means)
    spread = sum(
        w * (s * inner + np.outer(m - mean, m - mean))
        for w, s, inner, m in zip(weight, square, spreads, means, strict=True)
    )
    np.testing.assert_allclose(noises_of(contest, found.grams, pick), weight, atol=5e-3)
    told, covariance = moments(contest, found.grams, [(at, size)])
    np.testing.assert_allclose(told, mean, atol=2e-3)
    # A variance under an unknown factor is wider than one at its mean by dof / (dof - 2).
    np.testing.assert_allclose(
        covariance, spread * (N - BASE - 2) / (N - BASE), rtol=0.05, atol=1e-3
    )


def test_what_is_known_of_the_noise_counts_as_in_the_integral() -> None:
    """A log-normal prior of the noise factor, of data whose noise is a twentieth of one, one and
    twenty times one: the product of likelihood and prior over a grid of its logarithm."""
    columns, noises = world(0)
    spread, dof = np.log(5.0), 24.0
    grams = replace(posterior_of(columns, noises)[1].grams, spread=float(spread))
    power = dof * np.array([1.0 / 400.0, 1.0, 400.0])
    log = np.linspace(-5.0, 5.0, 4001)[:, None]
    each = -dof * log - 0.5 * power * np.exp(-2.0 * log) - 0.5 * (log / spread) ** 2
    expected = np.logaddexp.reduce(each, axis=0)
    told = grams.log_noise(power, dof)
    np.testing.assert_allclose(told - told[1], expected - expected[1], atol=0.05)


def test_a_gain_has_the_interval_of_its_parts() -> None:
    """Nadeau and Bengio's (2003) interval of the mean of four equal parts, written out."""
    before, after = np.array([3.0, 2.0, 4.0, 3.0]), np.array([1.0, 1.5, 2.0, 1.0])
    found = difference(before, after, np.arange(4), 4, "mean")
    change = before - after
    reach = 3.182446 * np.std(change, ddof=1) / 2.0 * np.sqrt(1.0 + 4.0 / 3.0)
    assert (found.before, found.after, found.gain) == (3.0, 1.375, 1.625)
    assert (found.low, found.high) == pytest.approx((1.625 - reach, 1.625 + reach), rel=1e-6)
