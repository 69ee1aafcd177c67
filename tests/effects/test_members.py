"""Members of families that the printed equations do not reach."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.core.course import course_of, slope_of
from imucalib.core.effect import Context, Response, Truth
from imucalib.core.sphere import even_directions
from imucalib.effects.array.timing import slow
from imucalib.effects.strap import posture
from imucalib.units import MG, STANDARD_GRAVITY

H = 0.01
T = np.arange(600) * H
TONES = 2.0 * np.pi * np.array([0.7, 1.9, 3.8])


def behind(tau: float) -> np.ndarray:
    """(n, 3) of three tones behind a low-pass of `tau` s: 1 / (1 + i w tau)."""
    return np.imag(np.exp(1j * TONES * T[:, None]) / (1.0 + 1j * TONES * tau))


@pytest.mark.parametrize("reference", [0.0, 2e-3])
def test_times_against_a_reference_that_is_slow_itself(reference: float) -> None:
    """What is quicker than the reference has a negative time against it. (Second order of a time:
    (6 ms times 24 rad/s)² is 2 %.)"""
    true = np.array([reference, 0.0, 6e-3])
    value = np.repeat(behind(reference)[:, None], 3, axis=1)
    beside = np.stack([np.arange(600) > 0, np.arange(600) < 599], axis=1)
    course = course_of(value, slope_of(value, T, beside), T, beside)
    lag = np.broadcast_to((true - reference)[:, None], (600, 3, 1))
    found = slow(course, lag)
    kept = slice(50, -50)
    for k, tau in enumerate(true):
        want = behind(tau)
        slope = np.gradient(want, H, axis=0, edge_order=2)
        assert np.abs(found.value[kept, k] - want[kept]).max() < 2e-4
        assert np.abs(found.slope[kept, k] - slope[kept]).max() < 0.02 * TONES[-1]


def test_the_offset_is_along_gravity_and_as_the_equation_says() -> None:
    rng = np.random.default_rng(2)
    up = rng.standard_normal((7, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    sizes = rng.standard_normal(24)
    context = Context(7, {})
    effect = posture("24")
    delta = effect.act(sizes, Truth(STANDARD_GRAVITY * up[:, None]), context).delta[:, 0] / MG
    near = np.clip(up @ even_directions(24).T, -1.0, 1.0)
    t = np.linspace(-1.0, 1.0, 400_001)
    line = np.polynomial.Polynomial.fit(t, np.exp(24 / (4.0 * np.pi) * (t - 1.0)), 2)
    bumps = np.exp(24 / (4.0 * np.pi) * (near - 1.0)) - line(near)
    assert np.allclose(delta, (bumps @ sizes)[:, None] * up, rtol=0.01, atol=0.01)
    assert np.allclose(np.cross(delta, up), 0.0, atol=1e-12)
    assert np.all(effect.act(sizes, Truth(np.zeros((7, 1, 3))), context).delta == 0.0)


def test_an_offset_by_posture_holds_neither_bias_nor_scale() -> None:
    """Over a sphere of postures it is orthogonal to all that the nine parameters do to |a|."""
    up = even_directions(20_000)
    nine = np.stack([*up.T, *(up[:, i] * up[:, j] for i in range(3) for j in range(i, 3))], axis=1)
    for bumps in (24, 80):
        basis = posture(str(bumps)).basis(Truth(STANDARD_GRAVITY * up[:, None]), Context(20_000))
        along = np.einsum("nkip,ni->np", basis, up) / MG
        shares = nine.T @ along / np.sqrt(np.outer((nine**2).sum(0), (along**2).sum(0)))
        assert np.abs(shares).max() < 0.01  # the sum over a spiral


@pytest.mark.parametrize("bumps", [24, 80])
def test_all_bumps_together_are_the_sum_of_each(bumps: int) -> None:
    """At rest, in a throw and in free fall; ten mg a bump, to a hundred thousandth of a mg."""
    rng = np.random.default_rng(bumps)
    truth = Truth(np.concatenate([rng.normal(size=(200, 1, 3)) * 10.0, np.zeros((1, 1, 3))]))
    effect, context = posture(str(bumps)), Context(201)
    theta = 10.0 * rng.normal(size=bumps)
    assert isinstance(effect, Response)
    assert effect.total is not None
    due = effect.basis(truth, context) @ theta
    np.testing.assert_allclose(effect.total(theta, truth, context) / MG, due / MG, atol=1e-4)
