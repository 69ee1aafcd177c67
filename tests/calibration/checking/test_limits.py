"""Sizes with their units, as they are typed."""

from __future__ import annotations

import pytest

from imucalib.calibration.checking.limits import Limits, limits_of
from imucalib.errors import UsageError


def test_each_unit_is_about_its_own_thing() -> None:
    assert limits_of(["2mg", "0.1deg", "5e-1deg/s", "0.2 mm"]) == Limits(2.0, 0.1, 0.5, 0.2)
    assert limits_of([]) == Limits()


@pytest.mark.parametrize("text", ["2", "mg", "0mg", "-1mg", "nanmg", "1e999mg", "2 m/s", "1e-mg"])
def test_what_is_no_size_is_refused(text: str) -> None:
    with pytest.raises(UsageError):
        limits_of([text])


def test_one_limit_a_unit() -> None:
    with pytest.raises(UsageError, match="two limits"):
        limits_of(["1mg", "2mg"])
