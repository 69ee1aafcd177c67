"""Units at the border, their detection at rest, and normal gravity."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imucalib.errors import UnreadableInput, UsageError
from imucalib.units import (
    ACCELERATION_UNITS,
    RATE_UNITS,
    STANDARD_GRAVITY,
    detect_acceleration_unit,
    factor,
    local_gravity,
)


@pytest.mark.parametrize(
    ("unit", "si"),
    [("g", 9.80665), ("mg", 9.80665e-3), ("ug", 9.80665e-6), ("m/s2", 1.0), ("m/s²", 1.0),
     ("m/s^2", 1.0), ("[mg]", 9.80665e-3), (" milli-g ", 9.80665e-3), ("µg", 9.80665e-6),
     ("1e-6 g", 9.80665e-6)],
)  # fmt: skip
def test_acceleration(unit: str, si: float) -> None:
    assert factor(unit, ACCELERATION_UNITS) == pytest.approx(si, rel=1e-15)


@pytest.mark.parametrize(
    ("unit", "si"),
    [("rad/s", 1.0), ("dps", math.pi / 180), ("°/s", math.pi / 180), ("mrad/s", 1e-3)],
)
def test_rates(unit: str, si: float) -> None:
    assert factor(unit, RATE_UNITS) == pytest.approx(si, rel=1e-15)


@pytest.mark.parametrize("unit", ["furlong", "", "G/s", "m/s"])
def test_an_unknown_unit_is_refused_with_the_choices(unit: str) -> None:
    with pytest.raises(UsageError) as caught:
        factor(unit, ACCELERATION_UNITS, "--unit")
    assert caught.value.where == "--unit"
    assert "m/s2" in caught.value.remedy


@given(st.sampled_from(sorted(ACCELERATION_UNITS)), st.floats(0.8, 1.2))
def test_the_unit_is_found_at_rest(unit: str, share: float) -> None:
    norms = np.full(5, share * STANDARD_GRAVITY / ACCELERATION_UNITS[unit])
    found = detect_acceleration_unit(norms, "file.csv")
    assert found.unit == unit
    assert unit in found.sentence


@pytest.mark.parametrize("norm", [0.0, 0.5, 2.0, 100.0, 16384.0, math.nan])
def test_a_norm_that_fits_no_unit_is_refused(norm: float) -> None:
    with pytest.raises(UnreadableInput, match="fits no known unit") as caught:
        detect_acceleration_unit(np.array([norm, norm]), "file.csv")
    assert caught.value.where == "file.csv"
    with pytest.raises(UnreadableInput):
        detect_acceleration_unit(np.zeros(0), "file.csv")


@pytest.mark.parametrize(
    ("latitude", "gravity"),
    # WGS 84's equator and pole (TR8350.2, table 3.4); 45 degrees by Somigliana's form.
    [(0.0, 9.7803253359), (90.0, 9.8321849378), (-90.0, 9.8321849378), (45.0, 9.80620)],
)
def test_normal_gravity_at_sea_level(latitude: float, gravity: float) -> None:
    assert local_gravity(latitude) == pytest.approx(gravity, abs=5e-6)


@given(st.floats(-90.0, 90.0), st.floats(0.0, 8000.0))
def test_gravity_falls_with_height_as_free_air(latitude: float, height: float) -> None:
    assert local_gravity(latitude) == pytest.approx(local_gravity(-latitude), rel=1e-14)
    fall = local_gravity(latitude) - local_gravity(latitude, height)
    # The free-air gradient is 0.3086 mGal a metre within 0.3 %.
    assert fall == pytest.approx(3.086e-6 * height, rel=4e-3, abs=1e-12)


@pytest.mark.parametrize("latitude", [90.1, -91.0, math.nan])
def test_a_latitude_off_the_globe_is_refused(latitude: float) -> None:
    with pytest.raises(UsageError):
        local_gravity(latitude)
