"""The noise of a long sheet, taken apart, against the dense matrix written out."""

from __future__ import annotations

from itertools import groupby

import numpy as np
import pytest

from imucalib.estimators.least_squares import fit as fit_model
from imucalib.loop.posterior.noise import Point, Terms, terms_of
from worlds.bench import base_model, bench, draw, ordinary_theta

ROWS = 120


@pytest.fixture(scope="module")
def terms() -> Terms:
    model, data = base_model(), bench(43, ROWS)
    return terms_of(fit_model(model, draw(model, ordinary_theta(model, data, 1), data, 42)))


def dense(terms: Terms, point: Point) -> np.ndarray:
    """V of a point without a walk, component by component."""
    whole = np.eye(terms.order.size)
    for factor, ratio in zip(terms.ways[point.sharing], point.ratio, strict=True):
        whole += ratio**2 * ((factor.near @ factor.near.T).toarray() + factor.wide @ factor.wide.T)
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
    said = terms.evidence(points, free, known, dof, lacked, power)
    for point, one in zip(points, said, strict=True):
        whole = dense(terms, point) + lacked @ lacked.T + np.diag(terms.axes @ (power - 1.0))
        gram = free.T @ np.linalg.solve(whole, free) + known.T @ known
        base = np.linalg.slogdet(gram[:-1, :-1])[1]
        rest = gram[-1, -1] - gram[-1, :-1] @ np.linalg.solve(gram[:-1, :-1], gram[:-1, -1])
        log_det = np.linalg.slogdet(whole)[1]
        expected = point.log_prior - 0.5 * (log_det + base + dof * np.log(rest))
        assert one == pytest.approx(expected, rel=1e-7)


def test_a_walk_between_knots_is_nearly_the_walk(terms: Terms) -> None:
    """What the knots leave out is small beside the noise of a reading."""
    for memory, factor in terms.walks.items():
        apart = np.abs(terms.order[:, None] - terms.order)
        axis = terms.axes[:, None] * terms.axes
        bias = np.sqrt(axis).sum(axis=-1) * (terms.axes.argmax(1)[:, None] == terms.axes.argmax(1))
        whole = np.exp(-apart / memory) * bias
        assert np.abs(factor @ factor.T - whole).max() < 0.05
