"""The offset of a posture: along gravity, of a smooth function of its direction."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.core.effect import Context, Response, Truth
from imucalib.effects import families
from imucalib.effects.worn.posture import centres, posture
from imucalib.units import MG, STANDARD_GRAVITY


def test_the_offset_is_along_gravity_and_as_the_equation_says() -> None:
    rng = np.random.default_rng(2)
    up = rng.standard_normal((7, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    sizes = rng.standard_normal(24)
    context = Context(7, {})
    effect = posture("24")
    delta = effect.act(sizes, Truth(STANDARD_GRAVITY * up[:, None]), context).delta[:, 0] / MG
    bumps = np.exp(24 / (4.0 * np.pi) * (up @ centres(24).T - 1.0))
    assert np.allclose(delta, (bumps @ sizes)[:, None] * up, rtol=0.01, atol=0.01)
    assert np.allclose(np.cross(delta, up), 0.0, atol=1e-12)
    assert np.all(effect.act(sizes, Truth(np.zeros((7, 1, 3))), context).delta == 0.0)


@pytest.mark.parametrize(
    ("n", "extra", "values"),
    [(79, {}, ()), (80, {}, ("24", "80")), (320, {"inclination": 0.1}, ())],
)
def test_a_posture_needs_a_clock_and_rests_but_no_dial(
    n: int, extra: dict[str, float], values: tuple[str, ...]
) -> None:
    known = {name: np.full(n, v) for name, v in {"time": 1.0, **extra}.items()}
    assert families()["posture"].values(Context(n, known)) == values
    assert families()["posture"].values(Context(n, {})) == ()


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
