"""Bias and scale against temperature, by their formulas."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.core.fit import StoredParameter
from imucalib.report.conditions import compose_temperature_section
from imucalib.report.render.document import Table
from worlds.stated import stated

SPAN = (5.0, 45.0)
VALUES = {
    "bias": (20.0, -15.0, 30.0),
    "scale": (0.01, -0.02, 0.005),
    "temperature_bias": (0.8, -0.5, 1.2),
    "temperature_scale": (0.4, -0.3, 0.2),
}


def rows_of(table: Table) -> np.ndarray:
    """(rows, 1 + 6) temperature, then value and half of the interval by axis."""
    return np.array([[float(v) for cell in row for v in cell.split("±")] for row in table.rows])


def test_bias_and_scale_are_those_of_the_law_with_its_interval() -> None:
    sd = np.repeat([0.5, 1e-4, 0.02, 0.01], 3)
    calibration = stated(VALUES, np.diag(sd**2), valid={"temperature": SPAN})
    bias, scale = (rows_of(t) for t in compose_temperature_section(calibration).blocks)
    assert bias[:, 0].tolist() == [5.0, 15.0, 25.0, 35.0, 45.0]
    away = bias[:, :1] - 25.0
    own, slope = (np.array(VALUES[n]) for n in ("bias", "temperature_bias"))
    assert bias[:, 1::2] == pytest.approx(own + slope * away, abs=0.2)
    half = np.tile(1.96 * np.hypot(0.5, 0.02 * away), (1, 3))
    assert bias[:, 2::2] == pytest.approx(half, rel=0.1)
    own, slope = (np.array(VALUES[n]) for n in ("scale", "temperature_scale"))
    assert scale[:, 1::2] == pytest.approx(100.0 * own + 0.1 * slope * away, abs=0.02)
    half = np.tile(1.96 * np.hypot(0.01, 0.001 * away), (1, 3))
    assert scale[:, 2::2] == pytest.approx(half, rel=0.1)


def test_a_rate_has_its_own_table() -> None:
    bias, slope = (0.4, -0.3, 0.2), (0.02, -0.01, 0.03)
    own = (("gyro_gain", tuple(np.eye(3).ravel())), ("gyro_temperature_bias", slope))
    more = [
        StoredParameter(f"{effect}_{axis}", effect, "gyroscope", float(v), sd, unit)
        for effect, values, unit, sd in (
            (*own[0], "1", 1e-4),
            (*own[1], "deg/s/degC", 1e-3),
            ("gyro_rest_bias", bias, "deg/s", 0.01),
        )
        for axis, v in zip("xyz" if len(values) == 3 else range(9), values, strict=True)
    ]
    whole = stated({n: VALUES[n] for n in ("bias", "scale")}, valid={"temperature": SPAN})
    parameters = (*whole.parameters, *more)
    sd = np.array([p.sd for p in parameters])
    made = replace(whole, parameters=parameters, covariance=np.diag(sd**2))
    (table,) = compose_temperature_section(made).blocks
    seen = rows_of(table)
    away = seen[:, :1] - 25.0
    assert seen[:, 1::2] == pytest.approx(np.array(bias) + np.array(slope) * away, abs=0.02)
    assert seen[:, 2::2] == pytest.approx(np.tile(1.96 * np.hypot(0.01, 1e-3 * away), 3), rel=0.1)


def test_nothing_follows_the_temperature() -> None:
    plain = stated({n: VALUES[n] for n in ("bias", "scale")}, valid={"temperature": SPAN})
    assert compose_temperature_section(plain).blocks == ()
