"""Laws of a recording's noise: a filter that never makes V does what V does, and what is followed
is what normal theory says of the walk."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from imucalib.core.effect import Context
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm
from imucalib.effects import catalogue, named
from imucalib.estimators.least_squares import fit
from imucalib.loop.candidates import Searched, searched
from imucalib.loop.posterior.catalogue import components_of
from imucalib.loop.posterior.gram import Grams, without
from imucalib.loop.posterior.problem import Problem, problem_of
from imucalib.loop.posterior.recorded import Course, course_of, fit_at, recorded_grams, whitener
from imucalib.loop.posterior.recording import close_recording, followed
from imucalib.units import MG

G, HOUR = 9.80665, 3600.0
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


def worn(seed: int, n: int = 90, wander: float = 0.0, hours: float = 8.0) -> Observations:
    """Postures of two days in plain numpy, 0.3 mg; wander : mg, of the bias."""
    rng = np.random.default_rng(seed)
    time = np.sort(rng.uniform(0.0, SPAN, n))
    u = rng.normal(size=(n, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    off = wander * rng.normal(size=(n, 3))
    for k in range(1, n):
        keep = np.exp((time[k - 1] - time[k]) / (hours * HOUR))
        off[k] = keep * off[k - 1] + np.sqrt(1.0 - keep**2) * off[k]
    gain = np.eye(3) + np.diag([0.004, -0.003, 0.002])
    reading = 1000.0 * u @ gain.T + [12.0, -9.0, 20.0] + off + 0.3 * rng.normal(size=(n, 3))
    covariates = {"time": time, "order": time / SPAN, "record": np.arange(n, dtype=float)}
    return Observations(
        reading[:, None] * MG,
        np.full((n, 1, 3), MG),
        KnownNorm(n, G),
        Context(n, covariates),
        np.minimum((time / SPAN * 12).astype(int), 11),
        tuple(f"run {k + 1}" for k in range(n)),
    )


def base() -> Model:
    return Model(tuple(named(name) for name in ("bias", "scale", "non_orthogonality")))


def asked() -> Searched:
    return searched((), (), {}, lambda effect: effect.stage == "sensor")


@cache
def made() -> tuple[Problem, Grams, Course]:
    data = worn(2, wander=0.6)
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


def test_what_is_told_is_taken_back_into_the_misfit() -> None:
    """Linearised where an effect is in the model, the problem says the same of its size."""
    problem, _, _ = made()
    plain = problem.fit
    drift = catalogue()["bias_drift"]
    model = Model((*plain.model.effects, drift))
    theta = np.concatenate([plain.theta, [0.05, -0.02, 0.03]])
    at = fit_at(model, plain.observations, theta, np.eye(theta.size))
    parts = components_of(plain.model, plain.observations, asked())
    there = problem_of(at, parts, plain.model)
    assert there.columns[:, -1] == pytest.approx(problem.columns[:, -1], abs=2e-3)


@pytest.mark.slow
def test_a_walk_is_followed_where_it_is_and_nowhere_else() -> None:
    known = np.zeros(240)
    for wander in (0.0, 1.5):
        plain = fit(base(), worn(7, 240, wander))
        closed = close_recording(plain, asked(), known)
        found = followed(closed.loop.final, closed.course)
        assert (found is not None) == (wander > 0.0)
        assert closed.loop.verdict == "nothing missing"
        if found is not None:
            error = np.std(found.at.residual * found.at.unit) / MG
            assert error < 0.5 * np.std(plain.at.residual * plain.at.unit) / MG
