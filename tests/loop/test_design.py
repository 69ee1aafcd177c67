"""One held-out design, and what it says of a gain."""

from __future__ import annotations

import numpy as np
import pytest

from gates.bounds import at_most
from imucalib.loop.held_out import difference, folds_of
from worlds.bench import bench


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


def test_stretches_have_a_gap() -> None:
    folds = folds_of(_grouped(240, 12))
    assert len(folds) == 12
    for fold in folds[1:-1]:
        away = np.abs(fold.rest[:, None] - fold.rows[None]).min()
        assert away == 2  # 3 % of twenty rows, rounded up, are left between


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


def test_the_gain_is_in_the_errors_unit() -> None:
    before, after = np.full(12, 3.0), np.full(12, 1.0)
    for metric in ("rms", "mean"):
        found = difference(before, after, np.arange(12), 10, metric)  # type: ignore[arg-type]
        assert found.gain == pytest.approx(2.0)
        assert found.low == pytest.approx(2.0)
        assert found.high == pytest.approx(2.0)
        assert found.proved
