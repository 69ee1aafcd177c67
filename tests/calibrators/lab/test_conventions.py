"""Angle conventions: nothing is lost in and out, and the presets say what is published."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imucalib.calibrators.lab.conventions import PRESETS, Conventions
from imucalib.core.references import unit_vector
from imucalib.units import DEG

conventions = st.builds(
    Conventions,
    gravity_sign=st.sampled_from(["down", "up"]),
    z_axis=st.sampled_from(["down-hole", "up-hole"]),
    inclination_zero=st.sampled_from(["horizontal", "vertical"]),
    toolface_zero_axis=st.sampled_from(["+x", "-x", "+y", "-y"]),
    toolface_sense=st.sampled_from(["clockwise", "counter-clockwise"]),
    toolface_offset=st.floats(-360.0, 360.0),
)


def _read(c: Conventions, inclination: float, tool_face: float) -> Any:
    """Reading over g of a tool at the table's angles in degrees."""
    return unit_vector(*c.inside(np.array(inclination), np.array(tool_face)))


@given(conventions, st.floats(-180.0, 180.0), st.floats(0.0, 360.0, exclude_max=True))
def test_in_and_out_again(c: Conventions, inclination: float, tool_face: float) -> None:
    i, t = c.outside(*c.inside(np.array([inclination]), np.array([tool_face])))
    assert i[0] == pytest.approx(inclination, abs=1e-10)
    assert abs(np.mod(t[0] - tool_face + 180.0, 360.0) - 180.0) < 1e-9


@given(conventions, st.floats(-1.5, 1.5), st.floats(0.0, 6.28))
def test_out_and_in_again(c: Conventions, inclination: float, tool_face: float) -> None:
    i, t = c.inside(*c.outside(np.array([inclination]), np.array([tool_face])))
    assert np.allclose(
        unit_vector(i, t), unit_vector(np.array([inclination]), np.array([tool_face]))
    )


@given(conventions)
def test_the_zero_axis_reads_most_at_tool_face_zero(c: Conventions) -> None:
    level = 0.0 if c.inclination_zero == "horizontal" else 90.0
    reading = _read(c, level, -c.toolface_offset)
    axis = dict(zip("xyz", np.eye(3), strict=True))[c.toolface_zero_axis[1]]
    sign = 1.0 if c.toolface_zero_axis[0] == "+" else -1.0
    assert np.allclose(reading, sign * axis, atol=1e-12)


@given(st.floats(1.0, 179.0), st.floats(0.0, 359.9))
def test_drilling_with_readings_of_gravity(inclination: float, tool_face: float) -> None:
    """I = atan2(hypot(Gx, Gy), Gz), high side GTF = atan2(-Gx, -Gy) with the scribe line on +y."""
    x, y, z = _read(PRESETS["drilling-gravity"], inclination, tool_face)
    assert np.arctan2(np.hypot(x, y), z) / DEG == pytest.approx(inclination, abs=1e-9)
    found = np.arctan2(-x, -y) / DEG
    assert abs(np.mod(found - tool_face + 180.0, 360.0) - 180.0) < 1e-9


@given(st.floats(1.0, 179.0), st.floats(0.0, 359.9))
def test_drilling_with_readings_of_specific_force(inclination: float, tool_face: float) -> None:
    """z up the hole reads +g when the tool hangs; high side: the axis on top reads most."""
    x, y, z = _read(PRESETS["drilling-force"], inclination, tool_face)
    assert np.arctan2(np.hypot(x, y), z) / DEG == pytest.approx(inclination, abs=1e-9)
    found = np.arctan2(-x, y) / DEG
    assert abs(np.mod(found - tool_face + 180.0, 360.0) - 180.0) < 1e-9


@given(st.floats(-89.0, 89.0), st.floats(0.0, 359.9))
def test_the_papers_formulae(inclination: float, tool_face: float) -> None:
    x, y, z = _read(PRESETS["paper"], inclination, tool_face)
    assert np.arctan2(z, np.hypot(x, y)) / DEG == pytest.approx(inclination, abs=1e-9)
    found = np.arctan2(x, y) / DEG
    assert abs(np.mod(found - tool_face + 180.0, 360.0) - 180.0) < 1e-9
