"""What is known of the truth, and directions spread over the sphere."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imucalib.arrays import Array
from imucalib.core.references import KnownNorm, KnownVector, Reference, angles_of, unit_vector
from imucalib.core.sphere import KnownDirection, coverage, even_directions

G = 9.8061
QUARTER = np.pi / 2.0
inclinations = st.floats(-QUARTER, QUARTER)
turns = st.floats(0.0, 2.0 * np.pi, exclude_max=True)


def _known_vector(**changes: Any) -> KnownVector:
    rng = np.random.default_rng(2)
    settings: dict[str, Any] = {
        "inclination": rng.uniform(-1.5, 1.5, 6),
        "tool_face": rng.uniform(0.0, 6.0, 6),
        "gravity": G,
        "inclination_setting": np.array([0, 0, 1, 1, 2, 2]),
        "tool_face_setting": np.array([0, 1, 1, 2, 3, 3]),
    }
    return KnownVector(**{**settings, **changes})


def _known_norm() -> tuple[KnownNorm, Array]:
    reference = KnownNorm(6, G)
    return reference, reference.start(np.random.default_rng(3).standard_normal((6, 1, 3)))


@given(inclinations, turns)
def test_a_direction_has_length_one_and_gives_its_angles_back(i: float, t: float) -> None:
    vector = unit_vector(np.array([i]), np.array([t]))
    assert np.linalg.norm(vector) == pytest.approx(1.0, abs=1e-15)
    back_i, back_t = angles_of(vector)
    assert back_i[0] == pytest.approx(i, abs=2e-8)
    # Near the vertical the tool-face is lost in proportion; compare on the circle.
    away = np.mod(back_t[0] - t + np.pi, 2.0 * np.pi) - np.pi
    assert abs(away) * np.cos(i) < 1e-14


def _slope_error(reference: Reference, eta: Array) -> float:
    """d truth / d η against central differences along the reference's own moves."""
    found = reference.directions(eta)
    worst = 0.0
    for entry in range(reference.eta_size):
        step = np.zeros(reference.eta_size)
        step[entry] = 1e-5
        up, down = (reference.truth(reference.move(eta, s)) for s in (step, -step))
        analytic = np.zeros_like(up)
        for column in range(found.index.shape[1]):
            rows = found.index[:, column] == entry
            analytic[rows] += found.derivative[rows, :, :, column]
        worst = max(worst, float(np.abs((up - down) / 2e-5 - analytic).max()))
    return worst


@pytest.mark.parametrize("size", [0.0, 1e-4, 0.05, 0.5], ids=["none", "tiny", "small", "beyond"])
def test_tilts_are_the_derivatives_at_any_attitude(size: float) -> None:
    directions = np.vstack([np.eye(3), -np.eye(3), unit_vector(np.array([0.3]), np.array([1.0]))])
    reference = KnownDirection(directions, G)
    eta = size * np.random.default_rng(4).standard_normal(reference.eta_size)
    assert _slope_error(reference, eta) < 1e-7
    assert reference.directions(eta).component == ("tilt", "tilt")


def test_known_norm_keeps_the_norm_and_is_flat() -> None:
    reference, eta = _known_norm()
    moved = reference.move(eta, 0.3 * np.random.default_rng(5).standard_normal(12))
    assert np.allclose(np.linalg.norm(reference.truth(moved), axis=-1), G, rtol=1e-14)
    found = reference.directions(eta)
    assert found.component == (None, None)
    # The two tangents are square to the direction and to each other, of length g.
    full = np.concatenate([found.derivative[:, 0], reference.truth(eta)[:, 0, :, None]], axis=-1)
    assert np.allclose(full.transpose(0, 2, 1) @ full, G**2 * np.eye(3), atol=1e-12 * G**2)


@given(st.lists(st.integers(0, 5), min_size=1, max_size=6))
def test_a_subset_keeps_what_rows_share(rows: list[int]) -> None:
    reference, picked = _known_vector(), np.array(rows)
    part = reference.take(picked)
    assert part.n == len(rows)
    assert np.array_equal(part.truth(np.zeros(part.eta_size)), reference.truth(np.zeros(7))[picked])
    pairs = ((reference.inclination_setting, part.inclination_setting),
             (reference.tool_face_setting, part.tool_face_setting))  # fmt: skip
    for whole, own in pairs:
        same = whole[picked][:, None] == whole[picked][None]
        assert np.array_equal(own[:, None] == own[None], same)
    # No setting without a row remains: each would be a free number that nothing determines.
    assert part.eta_size == len(np.unique(part.directions(np.zeros(part.eta_size)).index))
    assert KnownNorm(6, G).take(picked).n == len(rows)


@pytest.mark.parametrize("n", [60, 400])
def test_directions_are_spread_evenly(n: int) -> None:
    u = even_directions(n)
    np.testing.assert_allclose(np.linalg.norm(u, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(u.mean(axis=0), 0.0, atol=1.0 / n)
    np.testing.assert_allclose(u.T @ u / n, np.eye(3) / 3.0, atol=2.0 / n)
    apart = np.arccos(np.clip(u @ u.T - 2.0 * np.eye(n), -1.0, 1.0)).min(axis=1)
    own = np.sqrt(4.0 * np.pi / n)  # side of the square that each has for itself
    assert apart.min() > 0.8 * own
    assert apart.max() < 1.2 * own


def test_the_share_is_that_of_caps() -> None:
    """A cap of half angle a is (1 - cos a) / 2 of the sphere; opposite ones do not overlap."""
    one = coverage(np.array([[0.0, 0.0, 9.8]]))
    assert one == pytest.approx(0.5 * (1.0 - np.cos(np.radians(30.0))), abs=0.01)
    two = coverage(np.array([[0.0, 0.0, 9.8], [0.0, 0.0, -1.0]]))
    assert two == pytest.approx(2.0 * one, abs=0.01)
    assert coverage(even_directions(200)) == 1.0
