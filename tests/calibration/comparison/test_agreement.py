"""Whether calibrations agree, scatter and drift: each number by its equation."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from imucalib.calibration.comparison.agreement import (
    agreement,
    noise_dof,
    odd_ones,
)
from imucalib.calibration.comparison.basis import (
    Basis,
)
from imucalib.calibration.comparison.compare import (
    array_meanings,
    due,
    slope_of,
)
from imucalib.units import DEG


def basis(seed: int = 0, m: int = 4) -> Basis:
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(m, 2, 2))
    covariance = roots @ roots.swapaxes(1, 2) + 0.3 * np.eye(2)
    dof = np.array([9.0, 20.0, 14.0, 30.0])[:m]
    return Basis(("a", "b"), ("mg", "1"), 2.0 * rng.normal(size=(m, 2)), covariance, dof, "")


def test_all_agree_by_generalised_least_squares() -> None:
    made = basis()
    white = [np.linalg.inv(np.linalg.cholesky(c)) for c in made.covariance]
    y = np.concatenate([w @ v for w, v in zip(white, made.value, strict=True)])
    x = np.concatenate(white)
    mean, rest = np.linalg.lstsq(x, y, rcond=None)[:2]
    found = agreement(made)
    np.testing.assert_allclose(found.mean, mean)
    np.testing.assert_allclose(found.mean_sd, np.sqrt(np.diag(np.linalg.inv(x.T @ x))))
    assert found.chi2 == pytest.approx(rest[0])
    assert found.dof == 6
    assert found.z_rms == pytest.approx(np.sqrt(rest[0] / 6.0))
    assert found.p == pytest.approx(stats.f.sf(rest[0] / 6.0, 6, found.noise_dof))
    # Each against the mean of the others.
    for k in range(4):
        others = [j for j in range(4) if j != k]
        weight = np.sum([np.linalg.inv(made.covariance[j]) for j in others], axis=0)
        own = np.linalg.inv(weight)
        weighted = [np.linalg.solve(made.covariance[j], made.value[j]) for j in others]
        other = own @ np.sum(weighted, axis=0)
        whole = made.covariance[k] + own
        away = made.value[k] - other
        np.testing.assert_allclose(found.z[k], away / np.sqrt(np.diag(whole)))
        nu = noise_dof(np.array([made.covariance[k], own]),
                       np.array([made.dof[k], made.dof[others].sum()]))  # fmt: skip
        due = stats.f.sf(away @ np.linalg.solve(whole, away) / 2.0, 2, nu)
        assert found.without[k] == pytest.approx(due)


def test_fewer_than_half_may_be_the_odd_ones() -> None:
    def of(*away: float) -> tuple[int, ...]:
        m = len(away)
        value = np.array(away)[:, None] * np.ones(2)
        return odd_ones(Basis(("a", "b"), ("", ""), value, np.tile(np.eye(2), (m, 1, 1)),
                              np.full(m, 1e6), ""), 0.05)  # fmt: skip

    assert of(0.0, 0.1, -0.1) == ()
    assert of(0.0, 9.0, 0.1) == (1,)
    assert of(0.0, 9.0) == ()
    assert of(0.0, 9.0, 0.1, -9.0) == ()  # two of four
    assert of(0.0, 9.0, 0.1, -9.0, 0.2) == (1, 3)
    assert of(0.0, 4.0, 8.0, 12.0, 16.0) == ()


def test_a_limit_is_due_where_the_surest_drift_reaches_it() -> None:
    days = np.array([0.0, 50.0, 100.0])
    value = np.outer(days, [0.02, -0.04, 0.0])
    attitude, variance = np.eye(3), np.array([[1e-6, 1e-6, 4.0]] * 3)
    found = due(days, value, variance, attitude, 3.0)
    assert found.attitude.tolist() == [0.0, 1.0, 0.0]
    assert found.expected == pytest.approx(75.0)
    steepest = slope_of(days, value[:, 2], variance[:, 2], 30)
    assert found.earliest == pytest.approx(3.0 / steepest.half)
    none = due(days, 0.0 * value, variance, attitude, 3.0)
    assert none.expected == np.inf
    assert none.attitude.tolist() == [0.0, 0.0, 1.0]
    several = due(days, value, variance, attitude, 3.0, sensors=4)
    assert several.earliest < found.earliest


def test_an_arrays_places_and_gyros_that_differ_most() -> None:
    """Three boards of four IMUs; the first IMU is where places are counted from."""
    rng = np.random.default_rng(6)
    places, rates = rng.normal(size=(3, 3, 3)), rng.normal(size=(3, 4, 3))
    boards = [
        SimpleNamespace(
            triads=[SimpleNamespace(name=f"imu{k}", gyro_bias=DEG * r[k]) for k in range(4)]
        )
        for r in rates
    ]
    root = 0.1 * rng.normal(size=(3, 9, 9))
    covariance = root @ root.swapaxes(1, 2)
    made = Basis(("p",) * 9, ("mm",) * 9, places.reshape(3, 9), covariance, np.full(3, 9.0), "")
    (place, rate), (said,) = array_meanings(boards, made, {"mm": 0.5, "deg/s": 0.7})  # type: ignore[arg-type]
    away = places[:, None] - places[None]
    far = np.linalg.norm(away, axis=3)
    i, j, k = (int(v) for v in np.unravel_index(np.argmax(far), far.shape))
    assert set(place.pair) == {i, j}
    assert place.value == pytest.approx(far.max())
    assert place.sensor == f"imu{k + 1}"
    assert place.limit == 0.5
    along = away[i, j, k] / far.max()
    own = covariance[[i, j], 3 * k : 3 * k + 3, 3 * k : 3 * k + 3].sum(axis=0)
    assert place.sd == pytest.approx(np.sqrt(along @ own @ along))
    apart = np.abs(rates[:, None] - rates[None])
    i, j, k, axis = (int(v) for v in np.unravel_index(np.argmax(apart), apart.shape))
    assert set(rate.pair) == {i, j}
    assert rate.value == pytest.approx(apart.max())
    assert rate.sensor == f"imu{k}"
    assert f"{apart.max():.2g} deg/s at most (imu{k}, {'xyz'[axis]})" in said
    # Without limits: twice the largest stated sd of a coordinate.
    (place,), _ = array_meanings(boards, made, {})  # type: ignore[arg-type]
    assert place.limit == pytest.approx(2.0 * np.sqrt(np.einsum("kii->ki", covariance).max()))
