"""Small numerical parts of the core: undoing, derivatives in time, eigenvectors, what is open."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imucalib.arrays import Array, Flags
from imucalib.core import eigen as eigen_module
from imucalib.core.course import Course, course_of, delay, slope_of
from imucalib.core.effect import Context, Parameter, Truth
from imucalib.core.eigen import eigen
from imucalib.core.fit import null_directions
from imucalib.core.model import Model
from imucalib.effects import named
from imucalib.units import MG


@pytest.mark.parametrize("jump", [4.0, -4.0])
def test_a_reading_inside_a_jump_is_undone_to_within_it(jump: float) -> None:
    effect = named("shape@response:x:step:0.5")
    model = Model((effect,))
    x = np.zeros((400, 1, 3))
    x[:, 0, 0] = np.linspace(0.49, 0.51, 400) * 1000.0 * MG
    known = Context(400)
    theta = np.full(len(model.parameters(known)), jump)
    reading = x + effect.act(theta, Truth(x), known).delta
    reading += np.random.default_rng(1).normal(0.0, 1.0 * MG, reading.shape)
    found = model.correct(theta, reading, known)
    assert np.abs(found[:, 0, 0] - x[:, 0, 0]).max() < 8.0 * MG


H = 0.01  # s


def stretches(*lengths: int) -> tuple[Array, Flags]:
    """Times of stretches of consecutive samples, 0.3 s apart, and who is beside whom."""
    starts = np.cumsum([0.0, *(0.3 + H * n for n in lengths)])
    t = np.concatenate(
        [start + H * np.arange(n) for start, n in zip(starts, lengths, strict=False)]
    )
    near = np.diff(t) < 1.5 * H
    return t, np.column_stack([np.append(False, near), np.append(near, False)])


@pytest.mark.parametrize(("hz", "off"), [(2.0, 1e-5), (5.0, 1e-4), (10.0, 1.5e-3)])
def test_a_slope_is_that_of_the_swing(hz: float, off: float) -> None:
    """Plain differences are 0.3, 1.6 and 6.5 % too small."""
    t, beside = stretches(60)
    w = 2.0 * np.pi * hz
    slope = slope_of(np.sin(w * t)[:, None], t, beside)[5:-5, 0]
    np.testing.assert_allclose(slope / w, np.cos(w * t)[5:-5], atol=off)


@pytest.mark.parametrize("lag", [1e-3, 4e-3, 9e-3])
def test_what_is_corrected_by_neighbours_dies_out(lag: float) -> None:
    """A reading corrected by what it loses, again and again, with the true slope: noise that
    changes from sample to sample would grow 3.2 times a round at 9 ms."""
    t, beside = stretches(20)
    noise = np.where(np.arange(20) % 2, 1.0, -1.0)[:, None, None] * np.ones((1, 1, 3))
    still = np.zeros_like(noise)
    for _ in range(20):
        course = course_of(noise, still, t, beside)
        noise = course.value - delay(course, np.full((20, 1, 1), lag)).value
    assert np.abs(noise).max() < 1e-3


def test_a_delay_is_what_was_before_to_the_second_order() -> None:
    t = np.linspace(0.0, 1.0, 40)
    value, slope, bend = (
        np.broadcast_to(x[:, None, None], (40, 1, 3)) for x in (t**2, 2 * t, 2 + 0 * t)
    )
    late = delay(
        Course(value, slope, bend, bend, t, np.ones((40, 2), np.bool_)), np.full((40, 1, 1), 0.2)
    )
    np.testing.assert_allclose(late.value[:, 0, 0], (t - 0.2) ** 2, atol=1e-12)
    np.testing.assert_allclose(late.slope[:, 0, 0], 2.0 * (t - 0.2), atol=1e-12)


def _gives_up(matrices: np.ndarray) -> None:
    raise np.linalg.LinAlgError("Eigenvalues did not converge")


@pytest.mark.parametrize("shape", [(5, 5), (3, 4, 4), (2, 3, 2, 2)])
@pytest.mark.parametrize("fails", [False, True])
def test_a_matrix_is_what_its_eigenvectors_say(
    shape: tuple[int, ...], fails: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = np.random.default_rng(3).normal(size=shape)
    matrices = root @ np.swapaxes(root, -1, -2)
    if fails:
        monkeypatch.setattr(np.linalg, "eigh", _gives_up)
    values, vectors = eigen(matrices)
    np.testing.assert_allclose(
        (vectors * values[..., None, :]) @ np.swapaxes(vectors, -1, -2), matrices, atol=1e-12
    )
    assert np.all(np.diff(values, axis=-1) >= 0.0)


def test_a_hole_is_not_decomposed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(np.linalg, "eigh", _gives_up)
    with pytest.raises(np.linalg.LinAlgError):
        eigen(np.full((2, 2), np.nan))


def test_the_fast_method_is_called_here_alone() -> None:
    root = Path(eigen_module.__file__).parents[1]
    callers = {p.name for p in root.rglob("*.py") if "linalg.eigh(" in p.read_text("utf-8")}
    assert callers == {"eigen.py"}


NAMES = tuple(Parameter(name, "mg", 10.0, 99.0) for name in "abcdefg")


def told(jacobian: np.ndarray, factor: float = 1.0) -> tuple[str, ...]:
    return null_directions(jacobian, NAMES[: jacobian.shape[1]], factor)


@pytest.mark.parametrize(("sd", "open_"), [(29.0, False), (31.0, True)])
def test_open_is_known_worse_than_three_typical_sizes(sd: float, open_: bool) -> None:
    jacobian = np.diag([1.0, 1.0 / sd])
    assert told(jacobian) == (("b is not determined",) if open_ else ())
    assert told(2.0 * jacobian, 2.0) == told(jacobian)


def test_a_combination_is_told_by_its_largest_parts() -> None:
    """Those of a fifth of the largest or more, five at most, largest first."""
    way = np.array([1.0, -0.21, 0.19, 0.0, 0.0, 0.0, 0.0])
    way /= np.linalg.norm(way)
    assert told(np.eye(7) - np.outer(way, way)) == ("a cannot be told from b",)
    many = np.array([0.9, 1.0, 0.8, 0.7, 0.6, 0.5, 0.4])
    many /= np.linalg.norm(many)
    assert told(np.eye(7) - np.outer(many, many)) == ("b cannot be told from a, c, d, e",)
    rows = np.repeat(np.eye(7)[:3], 9, axis=0)
    assert len(told(rows)) == 4
    assert len(told(rows[:2])) == 6
    assert null_directions(np.zeros((4, 0)), (), 1.0) == ()
