"""The posterior over sets of effects and its evidence by hand: priors, held-out parts, verdicts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import groupby, permutations
from pathlib import Path

import numpy as np
import pytest

import imucalib
from gates.bounds import at_most
from imucalib.arrays import Array, Index
from imucalib.core.effect import Context
from imucalib.core.fit import Fit
from imucalib.core.observations import Observations
from imucalib.effects import catalogue, families
from imucalib.estimators.least_squares import fit
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.posterior import held_out as held_out_module
from imucalib.posterior.candidates import SearchedEffects, effects_to_search
from imucalib.posterior.closed_loop.closed import close_loop
from imucalib.posterior.closed_loop.found import Loop, Step, Unexplained
from imucalib.posterior.closed_loop.recorded import RunCourse, course_of, multiply_course, whitener
from imucalib.posterior.closed_loop.recording import close_recording, follow_bias
from imucalib.posterior.closed_loop.words import select_model
from imucalib.posterior.held_out import (
    Difference,
    difference,
    errors,
    folds_of,
    leave_groups_out,
    predict_fitted,
)
from imucalib.posterior.record_errors import RecordError
from imucalib.posterior.search.catalogue import components_of
from imucalib.posterior.search.explored import SearchedPosterior, search_posterior
from imucalib.posterior.search.gram import Grams, leave_out, marginalize
from imucalib.posterior.search.noise import NoiseHypothesis, Terms, terms_of
from imucalib.posterior.search.problem import Problem, problem_of
from imucalib.units import MG
from worlds.at_rest import at_rest, worn
from worlds.bench import NINE, base_model, bench, draw, ordinary_theta


def asked() -> SearchedEffects:
    return effects_to_search((), (), {}, lambda effect: effect.stage == "sensor")


@cache
def found(seed: int = 1, bend: float = 3.0) -> SearchedPosterior:
    return search_posterior(fit(base_model(NINE), at_rest(seed, 40, bend)), asked())


def log_evidence(problem: Problem, grams: Grams, blocks: list[tuple[np.ndarray, float]]) -> float:
    return marginalize(grams, problem.flat, *blocks).evidence(grams.numbers - problem.base)


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
        products = replace(grams.products, columns=columns[:n])
        drawn = replace(grams, products=products)
        at = problem.choices[j].at
        gain = log_evidence(other, drawn, [(at, 1.0)]) - log_evidence(other, drawn, [])
        ratios.append(np.exp(gain))
    assert np.mean(ratios) == pytest.approx(1.0, abs=4.0 * np.std(ratios) / 20.0)


@pytest.mark.parametrize("seed", range(6))
def test_a_clean_recording_lacks_nothing(seed: int) -> None:
    assert not select_model(found(seed, 0.0).problem, found(seed, 0.0).posterior).places


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
    loop = close_loop(base_model(NINE), data.set_reading(reading), asked()).loop
    assert [r.where for r in loop.records] == ["row 12"]
    assert not loop.steps


def test_the_same_recording_gives_the_same_answer_in_any_order() -> None:
    """By the size of gravity alone, and without an order, rows have none."""
    data = at_rest(5, 40, bend=3.0)
    data = replace(data, context=Context(data.n))
    mixed = data.take(np.random.default_rng(0).permutation(data.n))
    one, two = (search_posterior(fit(base_model(NINE), d), asked()) for d in (data, mixed))
    assert one.posterior.probability[0] == pytest.approx(two.posterior.probability[0], rel=1e-6)


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


@cache
def made() -> tuple[Problem, Grams, RunCourse]:
    data = worn(2, drift=0.6)
    plain = fit(base_model(NINE), data)
    course, _ = course_of(plain, np.zeros(data.n))
    problem = problem_of(plain, components_of(plain.model, data, asked()))
    return problem, multiply_course(problem, course), course


def test_runs_left_out_are_as_good_as_never_taken() -> None:
    """The walk goes on through the gap: V of the rest is a part of V."""
    problem, grams, course = made()
    rows = np.arange(20, 35)
    kept = np.setdiff1d(np.arange(len(problem.columns)), rows)
    left = leave_out(grams, problem, rows)
    some = problem.columns[kept][:, [0, 4, -1]]
    for e, walk in enumerate(left.points):
        assert hasattr(walk, "size")
        assert hasattr(walk, "memory")
        shares = course.shares[kept] * walk.size
        v = dense(course.time[kept], course.variance[kept], shares, walk.memory)
        volume = np.linalg.slogdet(v)[1]
        assert left.log_weight[e] == pytest.approx(walk.log_prior - 0.5 * volume)
        gram = left.rows(np.array([0, 4]))[e][:, [0, 4, -1]]
        assert gram == pytest.approx((some.T @ np.linalg.solve(v, some))[:2], rel=1e-8)
    assert left.numbers == grams.numbers - rows.size


@pytest.mark.slow
def test_a_walk_is_followed_where_it_is_and_nowhere_else() -> None:
    known = np.zeros(240)
    for drift in (0.0, 1.5):
        plain = fit(base_model(NINE), worn(7, 240, drift))
        closed = close_recording(plain, asked(), known)
        found = follow_bias(closed.loop.final, closed.course)
        assert (found is not None) == (drift > 0.0)
        assert closed.loop.verdict == "nothing missing"
        if found is not None:
            error = np.std(found.at.residual * found.at.unit) / MG
            assert error < 0.5 * np.std(plain.at.residual * plain.at.unit) / MG


def _grouped(n: int, groups: int) -> Observations:
    data = bench(1, n)
    return replace(data, group=np.arange(n) * groups // n)


@pytest.mark.parametrize(("n", "groups"), [(32, 32), (24, 24), (40, 20), (7, 7), (240, 12)])
def test_every_row_is_predicted_once_by_data_without_it(n: int, groups: int) -> None:
    data = _grouped(n, groups)
    folds = folds_of(data)
    assert sorted(np.concatenate([f.rows for f in folds])) == list(range(n))
    for fold in folds:
        assert not set(fold.rows) & set(fold.rest)
        assert not set(data.group[fold.rows]) & set(data.group[fold.rest])


@pytest.mark.parametrize(("n", "groups"), [(32, 32), (24, 24), (60, 40)])
def test_the_order_of_the_rows_is_no_part_of_the_design(n: int, groups: int) -> None:
    data = _grouped(n, groups)
    moved = np.random.default_rng(0).permutation(n)
    one = {frozenset(f.rows.tolist()) for f in folds_of(data)}
    two = {frozenset(moved[f.rows].tolist()) for f in folds_of(data.take(moved))}
    assert one == two


@pytest.mark.slow
def test_the_interval_covers_the_gain() -> None:
    """Independent pairs: the plain interval covers 95 %, the widened one more."""
    rng = np.random.default_rng(4)
    inside = proved = 0
    for _ in range(900):
        before = np.abs(rng.normal(size=40)) * 2.0
        after = np.abs(rng.normal(size=40)) * 2.0
        found = difference(before, after, np.arange(40), 10, "rms")
        inside += found.low <= 0.0 <= found.high
        proved += found.proved
    assert 900 - inside <= at_most(900, 0.004).most
    assert proved <= at_most(900, 0.004).most


def _clean(seed: int, n: int = 24) -> Fit:
    base, data = base_model(), bench(seed, n)
    return fit_model(base, draw(base, ordinary_theta(base, data, seed), data, 1000 + seed))


@cache
def _one_clean() -> Fit:
    return _clean(0)


def held_out_gap(fit: Fit) -> float:
    """Largest difference (m/s²) of held-out errors from those of literal refits, over the noise."""
    found, worst = leave_groups_out(fit).error, 0.0
    for row in range(fit.observations.n):
        rows = np.array([row])
        rest = fit_model(
            fit.model, fit.observations.without(rows), start=fit.theta, noise=fit.noise
        )
        literal = errors(rest, rest.theta, fit.observations.take(rows)).error[0]
        worst = max(worst, float(np.abs(found[row] - literal).max()))
    return worst / (fit.noise.factor * float(fit.observations.sigma.min()))


def test_held_out_errors_are_those_of_literal_refits() -> None:
    fit = _one_clean()
    assert held_out_gap(fit) < 0.01
    assert leave_groups_out(fit).rms() > predict_fitted(fit).rms()


def test_in_sample_errors_passed_off_as_held_out_are_caught(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def none_left_out(fit: Fit, group: Index) -> Iterator[tuple[Index, Array]]:
        yield from ((np.flatnonzero(group == key), fit.theta) for key in np.unique(group))

    monkeypatch.setattr(held_out_module, "each_left_out", none_left_out)
    assert held_out_gap(_one_clean()) > 0.1


ROWS = 120


@pytest.fixture(scope="module")
def terms() -> Terms:
    model, data = base_model(), bench(43, ROWS)
    found = fit_model(model, draw(model, ordinary_theta(model, data, 1), data, 42))
    return terms_of(problem_of(found, ()))


def dense_of(terms: Terms, point: NoiseHypothesis) -> np.ndarray:
    """V of a point without a walk, component by component."""
    whole = np.eye(terms.order.size)
    for factor, ratio in zip(terms.sharings[point.sharing], point.ratio, strict=True):
        whole += ratio**2 * ((factor.few @ factor.few.T).toarray() + factor.many @ factor.many.T)
    return whole


def of_each_way(terms: Terms) -> list[NoiseHypothesis]:
    """The noisiest point of every way of sharing that has no walk."""
    still = sorted((p for p in terms.points if not p.walk), key=lambda p: p.sharing)
    return [max(own, key=lambda p: min(p.ratio)) for _, own in groupby(still, lambda p: p.sharing)]


def test_the_inverse_is_that_of_the_whole_matrix(terms: Terms) -> None:
    for point in of_each_way(terms):
        whole, found = dense_of(terms, point), terms.covariance(point)
        np.testing.assert_allclose(found.solve(whole), np.eye(len(whole)), atol=1e-8)
        assert found.log_det == pytest.approx(np.linalg.slogdet(whole)[1], rel=1e-9)


def test_the_evidence_is_that_of_the_whole_matrix(terms: Terms) -> None:
    """Also beside what may be there too, and with one axis noisier than the others."""
    rng = np.random.default_rng(0)
    n, dof = terms.order.size, 300.0
    free, lacked = rng.standard_normal((n, 4)), rng.standard_normal((n, 5))
    known = rng.standard_normal((2, 4))
    power = np.array([1.0, 4.0, 1.0])
    points = of_each_way(terms)
    own = replace(terms, base=free, known=known, dof=dof)
    said = own.evidence(points, lacked, power)
    for point, one in zip(points, said, strict=True):
        whole = dense_of(terms, point) + lacked @ lacked.T + np.diag(terms.axes @ (power - 1.0))
        gram = free.T @ np.linalg.solve(whole, free) + known.T @ known
        base = np.linalg.slogdet(gram[:-1, :-1])[1]
        rest = gram[-1, -1] - gram[-1, :-1] @ np.linalg.solve(gram[:-1, :-1], gram[:-1, -1])
        log_det = np.linalg.slogdet(whole)[1]
        expected = point.log_prior - 0.5 * (log_det + base + dof * np.log(rest))
        assert one == pytest.approx(expected, rel=1e-7)


STEP = Step(effect="cubic", evidence_nats=9.0, certain=True)
CURVE = replace(STEP, effect="curve@bias:order:0:1:4", curve="bias against order")
RECORD = RecordError(3, "row 4", "y", 100.0, 3.0, "mg", "lost sign of y", (), 0.999)
LEFT = Unexplained("a", "order", "bias", 0.999, 9.0)
SURE = Difference(2.0, 1.0, 0.5, 1.5, 20)
UNSURE = replace(SURE, low=-0.1)


@pytest.mark.parametrize(
    ("loop", "word"),
    [
        (Loop(0, 1), "nothing missing"),
        (Loop(0, 1, steps=(STEP,), difference=SURE), "explained"),
        (Loop(0, 1, steps=(STEP,)), "explained"),  # nothing was left out, as declared effects
        (Loop(0, 1, steps=(STEP,), difference=UNSURE), "suspected"),
        (Loop(0, 1, steps=(STEP, CURVE), difference=SURE), "explained in part"),
        (Loop(0, 1, steps=(STEP,), unexplained=(LEFT,), difference=SURE), "explained in part"),
        (Loop(0, 1, steps=(CURVE,), difference=SURE), "unexplained"),
        (Loop(0, 1, unexplained=(LEFT,)), "unexplained"),
        (Loop(0, 1, records=(RECORD,)), "explained"),
        (Loop(0, 1, records=(replace(RECORD, probability=0.9),)), "suspected"),
        (Loop(0, 1, records=(RECORD, replace(RECORD, probability=0.9))), "suspected"),
        (Loop(0, 1, records=(RECORD,), unexplained=(LEFT,)), "explained in part"),
    ],
)
def test_the_verdict(loop: Loop[int], word: str) -> None:
    assert loop.verdict == word


@pytest.mark.parametrize(
    ("found", "proved", "holds"),
    [
        (SURE, True, True),
        (UNSURE, False, True),
        (replace(UNSURE, nats=3.0, nats_low=0.1), True, True),
        # Either is a proof.
        (replace(SURE, nats=3.0, nats_low=-0.1), True, True),
        (replace(SURE, nats=-3.0, nats_low=-9.0), True, True),
        # What made the printed error larger is refused, whatever the density says.
        (replace(UNSURE, after=2.1, nats=9.0, nats_low=4.0), False, False),
        (replace(UNSURE, after=2.0), False, True),
    ],
)
def test_what_a_gain_allows_to_say(found: Difference, proved: bool, holds: bool) -> None:
    assert (found.proved, found.holds) == (proved, holds)


@pytest.mark.parametrize(
    ("sizes", "walk"),
    [
        ((10.0, 20.0, 30.0), 0.0),
        *(
            pytest.param(sizes, walk, marks=pytest.mark.slow)
            for sizes, walk in (((10.0, 20.0, 30.0), 0.3), ((15.0, 25.0), 0.0), ((20.0,), 0.3))
        ),
    ],
)
def test_every_step_of_a_week_is_found(sizes: tuple[float, ...], walk: float) -> None:
    """mg, each in a direction of its own, under white noise and a walk of four hours: a walk of
    any size would swallow them one by one."""
    seed = 10 * len(sizes)
    rng, data = np.random.default_rng((seed, 1)), at_rest(seed, 160)
    hours = np.sort(rng.uniform(0.0, 168.0, data.n))
    at = np.sort(rng.choice(np.arange(15, 146, 10), len(sizes), replace=False))
    off = np.zeros((data.n, 3))
    for row, size in zip(at, rng.permutation(sizes), strict=True):
        axis = rng.normal(size=3)
        off[row:] += size * axis / np.linalg.norm(axis)
    near = np.exp(-np.abs(hours[:, None] - hours) / 4.0) + 1e-9 * np.eye(data.n)
    off += walk * np.linalg.cholesky(near) @ rng.normal(size=off.shape)
    known = {**data.context.covariates, "time": 3600.0 * hours}
    group = np.minimum(hours / 14.0, 11.0).astype(np.intp)
    data = replace(
        data, reading=data.reading + off[:, None] * MG, context=Context(data.n, known), group=group
    )
    closed = close_recording(fit(base_model(NINE), data), asked(), np.zeros(data.n))
    said = [s.effect.partition("@") for s in closed.loop.steps]
    assert {family for family, *_ in said} == {"bias_step"}
    found = np.sort([float(value.removesuffix("s")) / 3600.0 for *_, value in said])
    assert found.size == len(sizes)
    # Which run is the first after it the size of gravity alone says to a few.
    assert np.abs(np.searchsorted(hours, found) - at).max() <= 2
    assert closed.loop.verdict == "explained"


@pytest.mark.parametrize(
    "seed", [8, *(pytest.param(s, marks=pytest.mark.slow) for s in (4, 13, 20))]
)
def test_what_makes_held_out_data_worse_is_neither_corrected_nor_nothing(seed: int) -> None:
    """A swing of the bias in time, which no name has, on few rests."""
    n = 40
    rng, data = np.random.default_rng(seed), at_rest(seed, n, noise=1.0)
    t, _, sudden = np.linspace(0.0, 1.0, n), rng.integers(3), rng.choice([0, 1])
    size = rng.normal(size=3)
    course = 6.0 * np.exp(-t / 0.05)
    if not sudden:
        course = 4.0 * np.sin(2.0 * np.pi * t * rng.uniform(1.0, 4.0))
    moved = data.reading + (course[:, None] * size * MG)[:, None]
    closed = close_loop(base_model(NINE), replace(data, reading=moved), asked())
    loop, gain = closed.loop, closed.loop.difference
    assert gain is not None
    assert loop.complete < 0.05
    assert loop.verdict != "nothing missing"
    assert bool(loop.refuted) == (gain.after > gain.before)
    assert bool(loop.refuted) == (not loop.steps)
    if closed.left is not None:
        assert closed.left.after.rms() <= closed.left.before.rms()


def test_what_holds_is_corrected_though_it_is_not_proved() -> None:
    """Only data that took no part refuse a correction; few rests seldom prove one."""
    loop = close_loop(base_model(NINE), at_rest(1, 30, bend=0.9), asked()).loop
    assert loop.difference is not None
    assert (loop.difference.holds, loop.difference.proved) == (True, False)
    assert len(loop.steps) == 1
    assert not loop.refuted
