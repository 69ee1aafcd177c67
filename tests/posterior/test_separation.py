"""Plans that separate rivals: distances by plain least squares, promises by drawn data."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.posterior.closed_loop.separation import (
    Ambiguity,
    apart,
    separation,
)
from imucalib.posterior.odds import CERTAIN, PLANNED


def linear(seed: int, numbers: int, near: float, size: float) -> tuple[Ambiguity, Array]:
    """Two base columns and two rivals of one column that are alike but for `near`, with data of the
    first; and the columns."""
    rng = np.random.default_rng(seed)
    base, one, other = rng.normal(size=(numbers, 2)), *rng.normal(size=(2, numbers))
    rows = np.column_stack([base, one, one + near * other])
    data = size * rows[:, 2] + rng.normal(size=numbers)
    found = Ambiguity(
        effect="a",
        base=("base",),
        columns=("x", "y", "a", "b"),
        rivals=("a", "b"),
        blocks={"a": np.array([2]), "b": np.array([3])},
        gram=rows.T @ rows,
        along=rows.T @ data,
        power=float(data @ data),
        numbers=float(numbers),
    )
    return found, rows


def test_the_distance_is_that_of_least_squares() -> None:
    one, rows = linear(2, 60, 0.3, 1.0)
    for k, (truth, other) in enumerate(one.pairs):
        rest = rows[:, [0, 1, *one.blocks[other]]]
        for draw in range(3):
            signal = rows[:, one.blocks[truth]] @ one.sizes[truth][:, draw]
            left = signal - rest @ np.linalg.lstsq(rest, signal, rcond=None)[0]
            found = apart(one, one.gram)[k, draw]
            assert found == pytest.approx(np.linalg.norm(left), rel=1e-6)


def test_new_data_have_an_offset_of_their_own_after_a_power_up() -> None:
    one, _ = linear(0, 40, 0.1, 1.5)
    rows = np.random.default_rng(1).normal(size=(5, 4))
    later, pool = one.after_a_power_up({"y": 25.0}, np.array([rows.T @ rows]))
    assert later.columns == ("next_y", "x", "y", "a", "b")
    assert [at.tolist() for at in later.blocks.values()] == [[3], [4]]
    assert later.gram[0].tolist() == [25.0, 0.0, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(later.gram[1:, 1:], one.gram)
    for name, size in one.sizes.items():  # which tells the recording nothing of its rivals
        np.testing.assert_allclose(later.sizes[name], size, rtol=1e-6)
    np.testing.assert_allclose(later.along, [0.0, *one.along])
    assert np.all(apart(later, later.gram + pool[0]) <= apart(one, one.gram + rows.T @ rows))
    both = np.column_stack([rows[:, 1], rows])  # what the bias is off by acts as the bias does
    np.testing.assert_allclose(pool[0], both.T @ both)


@pytest.mark.parametrize("count", [60, 200, 600])
def test_what_is_promised_is_had(count: int) -> None:
    """Data are drawn with the first as the truth and judged by the maxima of both likelihoods."""
    one, _ = linear(0, 4000, 0.12, 0.6)
    rng = np.random.default_rng(1)
    base, a, b = rng.normal(size=(count, 2)), *rng.normal(size=(2, count))
    rows = np.column_stack([base, a, a + 0.4 * b])
    promised = separation(one, rows.T[None] @ rows / PLANNED[0]).ends["a"]
    certain = 0
    old = np.linalg.cholesky(one.gram).T  # as many columns as products: the recording itself
    every = np.vstack([old, rows])
    for _ in range(1000):
        y = 0.6 * every[:, 2] + rng.standard_normal(len(every))
        left = [float(np.linalg.lstsq(every[:, [0, 1, k]], y, rcond=None)[1][0]) for k in (2, 3)]
        certain += (left[1] - left[0]) / 2.0 > np.log(CERTAIN / (1.0 - CERTAIN))
    assert promised == pytest.approx(certain / 1000, abs=0.06)


@pytest.mark.parametrize("hidden", [1e-3, 1e-8, 1e-13, 0.0])
def test_columns_that_the_data_hardly_show_end_no_calibration(hidden: float) -> None:
    """A gain of a gyroscope that the motion hardly turns, beside one that it turns a million times
    the noise: the products of both are one block, and rounding leaves it no square root."""
    rng = np.random.default_rng(7)
    shown = 1e7 * rng.standard_normal((400, 4))
    base = np.column_stack([shown, shown @ rng.standard_normal((4, 3)) + hidden * shown[:, :3]])
    rivals = 1e6 * rng.standard_normal((400, 2)) + base[:, :2]
    every = np.column_stack([base, rivals])
    data = rivals @ np.array([0.5, 0.0]) + rng.standard_normal(400)
    gram = every.T @ every
    gram -= 4e-16 * np.outer(np.diag(gram), np.diag(gram)) ** 0.5  # as sums over blocks leave it
    one = Ambiguity(
        effect="one", base=("base",), columns=tuple(f"c{k}" for k in range(9)),
        rivals=("one", "two"), blocks={"one": np.array([7]), "two": np.array([8])},
        gram=gram, along=every.T @ data, power=float(data @ data), numbers=400.0,
    )  # fmt: skip
    for name, size in one.sizes.items():
        assert np.isfinite(size).all(), name
