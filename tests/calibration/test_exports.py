"""Coefficients for other programs: what they keep, and what they say of what they lose."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.calibration.calibration import Calibration, StoredParameter
from imucalib.core.effect import Context
from imucalib.effects import named
from imucalib.exports import exported
from imucalib.units import STANDARD_GRAVITY
from worlds.targets import by_ggir

Array = NDArray[np.float64]
VALUES = {
    "bias": (20.0, -15.0, 30.0),
    "scale": (0.01, -0.02, 0.005),
    "temperature_bias": (0.8, -0.5, 1.2),
    "quadratic": (1.0, -0.6, 0.8),
}
SPAN = (15.0, 35.0)


def calibration(*effects: str) -> Calibration:
    parameters = tuple(
        StoredParameter(p.name, name, "sensor", value, 0.1, p.unit)
        for name in effects
        for p, value in zip(named(name).parameters(Context(1)), VALUES[name], strict=True)
    )
    covariance = 0.01 * np.eye(len(parameters))
    error = {"unit": "mg", "raw": 40.0, "held_out": {"final": 1.5}}
    return Calibration(
        calibrator="actigraph",
        parameters=parameters,
        covariance=covariance,
        raw_unit="m/s2",
        raw_to_si=1.0,
        gravity=STANDARD_GRAVITY,
        status="ok",
        valid={"temperature": SPAN},
        facts={"errors": [error]},
    )


def world(effects: tuple[str, ...]) -> tuple[Array, Array]:
    """Readings (n, 3) in g of a sensor with these errors, written out anew, and the forces."""
    rng = np.random.default_rng(0)
    force = rng.normal(size=(4000, 3))
    force /= np.linalg.norm(force, axis=1, keepdims=True)
    warm = rng.uniform(*SPAN, size=(4000, 1)) - 25.0
    reading = force.copy()
    if "scale" in effects:
        reading += force * VALUES["scale"]
    reading += np.array(VALUES["bias"]) * 1e-3
    if "temperature_bias" in effects:
        reading += warm * np.array(VALUES["temperature_bias"]) * 1e-3
    if "quadratic" in effects:
        reading += force**2 * np.array(VALUES["quadratic"]) * 1e-3
    return reading, force


def c_numbers(text: str, name: str) -> Array:
    body = re.search(rf"{name}[^=]*= ([^;]*);", text)
    assert body
    return np.array([float(v) for v in re.findall(r"-?\d+\.\d+e[+-]\d+", body[1])])


def stated(text: str) -> list[float]:
    return [float(v) for v in re.findall(r"(\d+\.\d+) mg", text)]


@pytest.mark.parametrize("more", [("temperature_bias",), ("quadratic",)])
def test_a_c_header_says_in_mg_what_it_lacks(more: tuple[str, ...]) -> None:
    effects = ("bias", "scale", *more)
    made = exported(calibration(*effects), "x.csv", "c-header")
    reading, force = world(effects)
    M, b = c_numbers(made.text, "imucal_M").reshape(3, 3), c_numbers(made.text, "imucal_b")
    off = np.linalg.norm(reading @ M.T + b - force, axis=1) * 1e3
    (told,) = made.lost
    assert more[0] in told
    assert told in made.text
    mean, worst = stated(told)
    # The stated figures are at the ends and the middle of the range, the world is even in it.
    assert 0.6 * mean < off.mean() < 1.2 * mean
    assert off.max() < 1.1 * worst
    # No other linear correction does much better here.
    columns = np.column_stack([reading, np.ones(len(reading))])
    best = columns @ np.linalg.lstsq(columns, force, rcond=None)[0]
    assert off.mean() < 1.02 * np.linalg.norm(best - force, axis=1).mean() * 1e3


def test_a_row_of_ggir_carries_the_temperature() -> None:
    effects = ("bias", "scale", "temperature_bias")
    made = exported(calibration(*effects), "x.csv", "ggir-csv")
    row = by_ggir(made.text, "x.csv")
    reading, _ = world(effects)
    rng = np.random.default_rng(0)
    rng.normal(size=(4000, 3))
    warm = rng.uniform(*SPAN, size=(4000, 1))
    moved = reading + row["offset"] + row["temperature.offset"] * (warm - row["meantempcal"])
    error = np.abs(np.linalg.norm(row["scale"] * moved, axis=1) - 1.0)
    assert error.mean() < 1e-6
    assert row["cal.error.start"] == pytest.approx(0.04)
    assert row["cal.error.end"] == pytest.approx(0.0015)
    assert row["use.temperature"]
    assert any(lost.startswith("meantempcal") for lost in made.lost)
    assert "imucal" in row["QCmessage"]
    assert np.isnan(row["n.10sec.windows"])


def test_a_row_of_ggir_says_what_was_seen() -> None:
    whole = calibration("bias", "scale")
    seen = {"still_windows": 3437, "hours": 23.5}
    known = replace(whole, facts={**whole.facts, "coverage": seen})
    row = by_ggir(exported(known, "x.csv", "ggir-csv").text, "x.csv")
    assert (row["n.10sec.windows"], row["n.hours.considered"]) == (3437, 23.5)
    assert not row["use.temperature"]
