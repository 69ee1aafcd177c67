"""The posterior over sets of effects: evidence, priors, what was planted, long recordings."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest

import imucalib
from imucalib.core.effect import Context
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm
from imucalib.effects import catalogue, families, named
from imucalib.estimators.least_squares import fit
from imucalib.loop.candidates import Searched, searched
from imucalib.loop.posterior.catalogue import components_of
from imucalib.loop.posterior.closed import close_loop
from imucalib.loop.posterior.explored import Explored, explored
from imucalib.loop.posterior.gram import Grams, swept, without
from imucalib.loop.posterior.problem import Problem, problem_of
from imucalib.loop.posterior.recorded import Course, course_of, recorded_grams, whitener
from imucalib.loop.posterior.recording import close_recording, followed
from imucalib.loop.posterior.words import concluded
from imucalib.units import MG
from worlds.bench import base_model

G = 9.80665
NINE = ("bias", "scale", "non_orthogonality")


def at_rest(seed: int, n: int = 40, bend: float = 0.0, noise: float = 0.3) -> Observations:
    """Attitudes at random of a sensor in plain numpy; bend : mg/g² along each axis."""
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(n, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    gain = np.eye(3) + np.triu(0.003 * rng.normal(size=(3, 3))) + 0.004 * np.diag([1.0, -1.0, 0.5])
    reading = 1000.0 * u @ gain.T + [12.0, -9.0, 20.0] + bend * np.array([1.0, -0.8, 1.2]) * u**2
    reading = reading + noise * rng.normal(size=(n, 3))
    context = Context(n, {"order": np.linspace(0.0, 1.0, n), "record": np.arange(n, dtype=float)})
    return Observations(
        reading[:, None] * MG,
        np.full((n, 1, 3), MG),
        KnownNorm(n, G),
        context,
        np.arange(n),
        tuple(f"row {k + 1}" for k in range(n)),
    )


def asked() -> Searched:
    return searched((), (), {}, lambda effect: effect.stage == "sensor")


@cache
def found(seed: int = 1, bend: float = 3.0) -> Explored:
    return explored(fit(base_model(NINE), at_rest(seed, bend=bend)), asked())


def log_evidence(problem: Problem, grams: Grams, blocks: list[tuple[np.ndarray, float]]) -> float:
    return swept(grams, problem.flat, *blocks).evidence(grams.numbers - problem.base)


def test_the_evidence_of_a_set_does_not_depend_on_its_order() -> None:
    one = found()
    at = [c.at for c in one.problem.choices[:3]]
    sizes = (0.5, 2.0, 8.0)
    values = [
        log_evidence(one.problem, one.posterior.grams, [(at[k], sizes[k]) for k in order])
        for order in permutations(range(3))
    ]
    np.testing.assert_allclose(values, values[0], rtol=1e-9)


def test_the_evidence_is_that_of_the_joint_normal() -> None:
    """By the determinant and the quadratic form of the whole covariance, base flat."""
    one = found()
    problem, grams = one.problem, one.posterior.grams.of(np.array([0]))
    at, size = problem.choices[0].at, 2.0
    n = len(problem.fit.at.owner)
    x, c = problem.columns[:n, : problem.base], problem.columns[:n, at]
    y = problem.columns[:n, -1]
    whole = np.linalg.inv(grams.solves[0](np.eye(n)))

    def density(v: np.ndarray) -> float:
        inverse = np.linalg.inv(v)
        inner = x.T @ inverse @ x
        p = inverse - inverse @ x @ np.linalg.solve(inner, x.T @ inverse)
        dof = n - problem.base
        log_det = np.linalg.slogdet(v)[1] + np.linalg.slogdet(inner)[1]
        return float(-0.5 * log_det - 0.5 * dof * np.log(y @ p @ y))

    gain = log_evidence(problem, grams, [(at, size)]) - log_evidence(problem, grams, [])
    assert gain == pytest.approx(density(whole + size**2 * c @ c.T) - density(whole), rel=1e-6)


def test_no_effect_s_name_stands_in_the_room() -> None:
    """Nothing here knows a single effect: what is wrong of one is its prior or its columns."""
    room = Path(imucalib.__file__).parent / "loop" / "posterior"
    names = [n for n in (*catalogue(), *families()) if len(n) > 7 and "_" in n]
    for path in room.glob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert not [n for n in names if n in text], path.name


def test_the_mean_of_what_is_likely_against_a_clean_recording_is_one() -> None:
    """The evidence of a component over the base model averages one on data that lack nothing:
    whatever its columns, sizes and the noise's factor."""
    one = found(bend=0.0)
    problem, grams = one.problem, one.posterior.grams.of(np.array([0]))
    rng = np.random.default_rng(0)
    n = len(problem.fit.at.owner)
    inverse = grams.solves[0](np.eye(n))
    lower = np.linalg.cholesky(np.linalg.inv(inverse))
    (j,) = (
        j for j, c in enumerate(problem.choices) if c.member.name == "quadratic" and c.at.size == 3
    )
    ratios = []
    for _ in range(400):
        columns = problem.columns.copy()
        columns[:n, -1] = lower @ rng.normal(size=n)
        other = replace(problem, columns=columns)
        weighted = grams.products.weighted.copy()
        weighted[0][:, -1] = inverse @ columns[:n, -1]
        products = replace(grams.products, columns=columns[:n], weighted=weighted)
        drawn = replace(grams, products=products)
        at = problem.choices[j].at
        gain = log_evidence(other, drawn, [(at, 1.0)]) - log_evidence(other, drawn, [])
        ratios.append(np.exp(gain))
    assert np.mean(ratios) == pytest.approx(1.0, abs=4.0 * np.std(ratios) / 20.0)


@pytest.mark.parametrize("seed", range(6))
def test_a_clean_recording_lacks_nothing(seed: int) -> None:
    assert not concluded(found(seed, 0.0).problem, found(seed, 0.0).posterior).places


@pytest.mark.parametrize("seed", range(4))
def test_what_was_planted_stands_in_its_place_and_is_undone(seed: int) -> None:
    data = at_rest(seed, 60, bend=4.0)
    loop = close_loop(base_model(NINE), data, asked()).loop
    (step,) = loop.steps
    assert "quadratic" in {step.effect, *step.aliases}
    assert loop.difference is not None
    assert loop.difference.holds
    slices = loop.final.model.slices(data.context)
    if step.effect == "quadratic":
        size = loop.final.theta[slices["quadratic"]]
        np.testing.assert_allclose(size, [4.0, -3.2, 4.8], atol=5.0 * loop.final.sd.max())


def test_a_rest_that_was_none_is_set_aside_and_nothing_else() -> None:
    data = at_rest(3, 40)
    reading = data.reading.copy()
    reading[11] *= 1.02
    loop = close_loop(base_model(NINE), data.with_reading(reading), asked()).loop
    assert [r.where for r in loop.records] == ["row 12"]
    assert not loop.steps


def test_the_same_recording_gives_the_same_answer_in_any_order() -> None:
    """By the size of gravity alone, and without an order, rows have none."""
    data = at_rest(5, 40, bend=3.0)
    data = replace(data, context=Context(data.n))
    mixed = data.take(np.random.default_rng(0).permutation(data.n))
    one, two = (explored(fit(base_model(NINE), d), asked()) for d in (data, mixed))
    assert one.posterior.probability[0] == pytest.approx(two.posterior.probability[0], rel=1e-6)


RECORDED_G, HOUR = 9.80665, 3600.0
SPAN = 48.0 * HOUR


def dense(time: np.ndarray, d: np.ndarray, shares: np.ndarray, memory: float) -> np.ndarray:
    near = np.exp(-np.abs(time[:, None] - time) / memory)
    return np.diag(d) + near * (shares @ shares.T)


@pytest.mark.parametrize("n", [5, 16, 83])
def test_the_filter_whitens_as_the_dense_factor(n: int) -> None:
    rng = np.random.default_rng(n)
    time = np.sort(rng.uniform(0.0, 100.0, n))
    d, shares = rng.uniform(0.5, 2.0, (2, n)), rng.normal(size=(2, n, 4))
    memory, columns = np.array([2.0, 60.0]), rng.normal(size=(n, 3))
    white = whitener(time, d, shares, memory)
    seen, back = white(columns), white.back(white(columns))
    for e in range(2):
        v = dense(time, d[e], shares[e], memory[e])
        solved = np.linalg.solve(v, columns)
        assert seen[e].T @ seen[e] == pytest.approx(columns.T @ solved)
        assert back[e] == pytest.approx(solved)
        assert white.log_det[e] == pytest.approx(np.linalg.slogdet(v)[1])


def worn(seed: int, n: int = 90, drift: float = 0.0, hours: float = 8.0) -> Observations:
    """Postures of two days in plain numpy, 0.3 mg; drift : mg, of the bias."""
    rng = np.random.default_rng(seed)
    time = np.sort(rng.uniform(0.0, SPAN, n))
    u = rng.normal(size=(n, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    off = drift * rng.normal(size=(n, 3))
    for k in range(1, n):
        keep = np.exp((time[k - 1] - time[k]) / (hours * HOUR))
        off[k] = keep * off[k - 1] + np.sqrt(1.0 - keep**2) * off[k]
    gain = np.eye(3) + np.diag([0.004, -0.003, 0.002])
    reading = 1000.0 * u @ gain.T + [12.0, -9.0, 20.0] + off + 0.3 * rng.normal(size=(n, 3))
    covariates = {"time": time, "order": time / SPAN, "record": np.arange(n, dtype=float)}
    return Observations(
        reading[:, None] * MG,
        np.full((n, 1, 3), MG),
        KnownNorm(n, RECORDED_G),
        Context(n, covariates),
        np.minimum((time / SPAN * 12).astype(int), 11),
        tuple(f"run {k + 1}" for k in range(n)),
    )


def base() -> Model:
    return Model(tuple(named(name) for name in ("bias", "scale", "non_orthogonality")))


@cache
def made() -> tuple[Problem, Grams, Course]:
    data = worn(2, drift=0.6)
    plain = fit(base(), data)
    course, _ = course_of(plain, np.zeros(data.n))
    problem = problem_of(plain, components_of(plain.model, data, asked()))
    return problem, recorded_grams(problem, course), course


def test_runs_left_out_are_as_good_as_never_taken() -> None:
    """The walk goes on through the gap: V of the rest is a part of V."""
    problem, grams, course = made()
    rows = np.arange(20, 35)
    kept = np.setdiff1d(np.arange(len(problem.columns)), rows)
    left = without(grams, problem, rows)
    some = problem.columns[kept][:, [0, 4, -1]]
    for e, walk in enumerate(left.points):
        assert hasattr(walk, "size")
        assert hasattr(walk, "memory")
        shares = course.shares[kept] * walk.size
        v = dense(course.time[kept], course.variance[kept], shares, walk.memory)
        gram = left.rows(np.array([0, 4]))[e][:, [0, 4, -1]]
        assert gram == pytest.approx((some.T @ np.linalg.solve(v, some))[:2], rel=1e-8)
    assert left.numbers == grams.numbers - rows.size


@pytest.mark.slow
def test_a_walk_is_followed_where_it_is_and_nowhere_else() -> None:
    known = np.zeros(240)
    for drift in (0.0, 1.5):
        plain = fit(base(), worn(7, 240, drift))
        closed = close_recording(plain, asked(), known)
        found = followed(closed.loop.final, closed.course)
        assert (found is not None) == (drift > 0.0)
        assert closed.loop.verdict == "nothing missing"
        if found is not None:
            error = np.std(found.at.residual * found.at.unit) / MG
            assert error < 0.5 * np.std(plain.at.residual * plain.at.unit) / MG
