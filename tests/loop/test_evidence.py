"""Evidence of the loop by hand: held-out parts, columns, noise that lasts, verdicts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import groupby

import numpy as np
import pytest

from gates.bounds import at_most
from imucalib.arrays import Array, Index
from imucalib.core.fit import Fit
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.loop import held_out as held_out_module
from imucalib.loop.found import Loop, Step, Unexplained
from imucalib.loop.held_out import (
    Difference,
    difference,
    errors,
    fitted,
    folds_of,
    held_out,
)
from imucalib.loop.posterior.noise import Point, Terms, terms_of
from imucalib.loop.posterior.problem import problem_of
from imucalib.loop.record_errors import RecordError
from worlds.bench import base_model, bench, draw, ordinary_theta


def _grouped(n: int, groups: int):  # type: ignore[no-untyped-def]
    from dataclasses import replace

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
    found, worst = held_out(fit).error, 0.0
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
    assert held_out(fit).rms() > fitted(fit).rms()


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


def dense(terms: Terms, point: Point) -> np.ndarray:
    """V of a point without a walk, component by component."""
    whole = np.eye(terms.order.size)
    for factor, ratio in zip(terms.sharings[point.sharing], point.ratio, strict=True):
        whole += ratio**2 * ((factor.few @ factor.few.T).toarray() + factor.many @ factor.many.T)
    return whole


def of_each_way(terms: Terms) -> list[Point]:
    """The noisiest point of every way of sharing that has no walk."""
    still = sorted((p for p in terms.points if not p.walk), key=lambda p: p.sharing)
    return [max(own, key=lambda p: min(p.ratio)) for _, own in groupby(still, lambda p: p.sharing)]


def test_the_inverse_is_that_of_the_whole_matrix(terms: Terms) -> None:
    for point in of_each_way(terms):
        whole, found = dense(terms, point), terms.covariance(point)
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
        whole = dense(terms, point) + lacked @ lacked.T + np.diag(terms.axes @ (power - 1.0))
        gram = free.T @ np.linalg.solve(whole, free) + known.T @ known
        base = np.linalg.slogdet(gram[:-1, :-1])[1]
        rest = gram[-1, -1] - gram[-1, :-1] @ np.linalg.solve(gram[:-1, :-1], gram[:-1, -1])
        log_det = np.linalg.slogdet(whole)[1]
        expected = point.log_prior - 0.5 * (log_det + base + dof * np.log(rest))
        assert one == pytest.approx(expected, rel=1e-7)


STEP = Step("cubic", 9.0, (), (), certain=True)
CURVE = replace(STEP, effect="curve@bias:order:0:1:4", curve=True)
RECORD = RecordError(3, "row 4", "y", 100.0, 3.0, "mg", "lost sign of y", (), 0.999)
LEFT = Unexplained("a", "order", "bias", 0.999, 9.0)
SURE = Difference(2.0, 1.0, 0.5, 1.5, 0.6, 20)
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
    ("found", "proved", "likely", "holds"),
    [
        (SURE, True, True, True),
        (UNSURE, False, True, True),
        (replace(UNSURE, plain_low=-0.1), False, False, True),
        (replace(UNSURE, after=2.1, plain_low=-0.3), False, False, False),
        (replace(UNSURE, nats=3.0, nats_low=0.1), True, True, True),
        # Without a gain beyond the scatter both error and density have to gain.
        (replace(UNSURE, plain_low=-0.1, nats=0.1, nats_low=-2.0), False, False, True),
        (replace(UNSURE, plain_low=-0.1, nats=-0.1, nats_low=-2.0), False, False, False),
        (replace(UNSURE, after=2.1, plain_low=-0.3, nats=0.1, nats_low=-2.0), False, False, False),
        # The density proves it where the error moves within its scatter, and not beyond.
        (replace(UNSURE, after=2.1, plain_low=-0.3, nats=9.0, nats_low=4.0), True, True, True),
        (replace(UNSURE, after=2.1, plain_low=-0.15, nats=9.0, nats_low=4.0), True, True, False),
    ],
)  # fmt: skip
def test_what_a_gain_allows_to_say(
    found: Difference, proved: bool, likely: bool, holds: bool
) -> None:
    assert (found.proved, found.likely, found.holds) == (proved, likely, holds)
