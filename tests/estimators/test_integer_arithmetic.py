"""Rounding of the integer descent against decimals, for both signs."""

from __future__ import annotations

from decimal import ROUND_HALF_UP, Decimal

import numpy as np
import pytest

from imucalib.errors import NotConverged
from imucalib.estimators.gradient_descent import _demand, _divided, _shifted

VALUES = np.arange(-50, 51)


@pytest.mark.parametrize("divisor", [2, 7, 10, 16])
def test_division_rounds_halves_away_from_zero(divisor: int) -> None:
    want = [
        int((Decimal(int(v)) / divisor).quantize(Decimal(1), rounding=ROUND_HALF_UP))
        for v in VALUES
    ]
    assert _divided(VALUES, divisor).tolist() == want


def test_a_shift_rounds_to_the_nearest() -> None:
    away = _shifted(VALUES, 3) - VALUES / 8.0
    assert np.abs(away).max() == 0.5
    assert set(away[np.abs(away) == 0.5]) == {0.5}  # halves go up


@pytest.mark.parametrize("sign", [1, -1])
def test_what_leaves_the_range_is_refused(sign: int) -> None:
    _demand(np.array([0, sign * (2**15 - 1)]), 16)
    with pytest.raises(NotConverged):
        _demand(np.array([0, sign * 2**15]), 16)
