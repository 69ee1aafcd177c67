"""A model undone by tables and few steps is the model undone by Newton's method."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.calibration.apply import apply_to_recording
from imucalib.calibration.calibration import Calibration, StoredParameter
from imucalib.calibration.undo import Undo
from imucalib.core.effect import Context
from imucalib.core.model import Model
from imucalib.effects import catalogue, known, named
from imucalib.recording.recording import Channel, Recording
from imucalib.units import MG, STANDARD_GRAVITY

Array = NDArray[np.float64]
NINE = ("bias", "scale", "non_orthogonality")
TEMPERATURE = ("temperature_bias", "temperature_scale")
SETS = [
    NINE,
    (*NINE, "converter@y"),
    (*NINE, "converter@xyz", *TEMPERATURE),
    (*NINE, "quadratic", "cubic"),
    (*NINE, "asymmetry", "cross_axis"),
    (*NINE, "hysteresis"),
    (*NINE, "temperature_bias", "bias_drift", "curve@response:x:-1:1:8"),
]


def sensor(names: tuple[str, ...], seed: int = 0) -> tuple[Model, Array]:
    """The effects at random sizes of a few milli-g at 1 g."""
    rng = np.random.default_rng(seed)
    effects = [effect for n in names if (effect := known(n)) is not None]
    assert len(effects) == len(names)
    model = Model(tuple(effects))
    theta = np.array([rng.normal() * p.typical for p in model.parameters(Context(1))])
    return model, theta


def around(n: int, seed: int, size: float = 1.0) -> tuple[Array, Context]:
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(n, 3))
    reading = size * STANDARD_GRAVITY * u / np.linalg.norm(u, axis=1, keepdims=True)
    covariates = {
        "temperature": rng.uniform(15.0, 35.0, n),
        "order": np.linspace(0.0, 1.0, n),
        **{f"previous_{a}": rng.uniform(-9.0, 9.0, n) for a in "xyz"},
    }
    return reading, Context(n, covariates)


@pytest.mark.parametrize("names", SETS, ids=lambda names: "+".join(names[3:]) or "nine")
@pytest.mark.parametrize("size", [0.7, 1.0, 2.5])
def test_it_is_what_newton_finds(names: tuple[str, ...], size: float) -> None:
    model, theta = sensor(names)
    reading, context = around(9000, 3, size)
    done = Undo(model, theta)(reading, context)
    exact = model.correct(theta, reading[:, None], context)[:, 0]
    assert done.settled.all()
    # A micro-g; the sharpest curve bends between two entries of a table.
    assert np.abs(done.force - exact).max() < 1e-3 * MG


def calibration(names: tuple[str, ...], valid: dict[str, tuple[float, float]]) -> Calibration:
    model, theta = sensor(names)
    stored = tuple(
        StoredParameter(p.name, e.name, e.stage, 0.0, 0.1, p.unit)
        for e in model.effects
        for p in e.parameters(Context(1))
    )
    every = tuple(replace(p, value=float(v)) for p, v in zip(stored, theta, strict=True))
    return Calibration(
        calibrator="lab", parameters=every, covariance=np.eye(len(every)), raw_unit="m/s2",
        raw_to_si=1.0, gravity=STANDARD_GRAVITY, status="ok", reasons=(), valid=valid,
    )  # fmt: skip


def recorded(n: int, warm: Array | None = None, size: float = 1.0) -> Recording:
    t = np.arange(float(n))
    values, _ = around(n, 8, size)
    channels = {"acc": Channel(t, values, "m/s2", "acceleration", "imu0", 1.0)}
    if warm is not None:
        channels["warm"] = Channel(t, warm[:, None], "degC", "temperature", "imu0", 1.0)
    return Recording(channels, "made", "made", "", start_ns=0)


def test_hysteresis_is_left_out_with_its_size() -> None:
    span = {f"previous_{a}": (-9.8, 9.8) for a in "xyz"}
    found = apply_to_recording(calibration((*NINE, "hysteresis"), span), recorded(50))
    (note,) = [n for n in found.notes if "hysteresis" in n]
    model, theta = sensor((*NINE, "hysteresis"))
    largest = float(np.linalg.norm(theta[-3:]))  # mg/g at 1 g on every axis
    size = float(note.partition("up to ")[2].partition(" mg")[0])
    assert size == pytest.approx(largest, rel=0.05)
    without = model.minus("hysteresis").correct(
        theta[:-3], recorded(50).channels["acc"].values[:, None], Context(50)
    )
    assert np.allclose(found.channels["acc"].values, without[:, 0], atol=1e-6)


def test_samples_beyond_the_calibrated_range_are_counted_and_kept() -> None:
    names = (*NINE, "temperature_bias", "quadratic")
    made = calibration(names, {"temperature": (20.0, 30.0)})
    warm = np.where(np.arange(200) < 40, 41.0, 25.0)  # no jump that comes back
    found = apply_to_recording(made, recorded(200, warm, size=3.0))
    notes = " ".join(found.notes)
    assert "40 of 200 samples lie outside the calibrated temperature, 20 to 30 °C" in notes
    values = recorded(200, warm, 3.0).channels["acc"].values
    far = int((np.abs(values) > 1.1 * STANDARD_GRAVITY).any(axis=1).sum())
    assert f"{far} of 200 samples read more than 1.1 g" in notes
    model, theta = sensor(names)
    exact = model.correct(theta, values[:, None], Context(200, {"temperature": warm}))[:, 0]
    assert np.allclose(found.channels["acc"].values, exact, atol=1e-5)
    inside = apply_to_recording(made, recorded(200, np.full(200, 25.0)))
    assert not any("outside" in n or "1.1 g" in n for n in inside.notes)


def test_every_steady_effect_of_the_catalogue_is_undone() -> None:
    for name, effect in catalogue().items():
        if effect.stage != "sensor" or effect.needs or effect.channel != "acceleration":
            continue
        own = tuple(dict.fromkeys((*NINE, name)))
        model, theta = sensor(own)
        reading, context = around(300, 9)
        exact = model.correct(theta, reading[:, None], context)[:, 0]
        assert np.allclose(Undo(model, theta)(reading, context).force, exact, atol=1e-3 * MG), name
    assert named("bias") is not None


@pytest.mark.parametrize("later", [0.0, 7200.0, -3600.0])
def test_the_time_of_day_and_of_the_calibration_go_by_the_clock(later: float) -> None:
    """A bias of one day's period and a drift, as numbers by hand."""
    start = 1_700_000_000  # s; 22:13:20 UTC
    names = ("bias", "bias_drift", "time_of_day")
    made = calibration(names, {"order": (0.0, 1.0)})
    clock = {"start_ns": str(start * 10**9), "span_s": 600.0}
    made = replace(made, facts={"clock": clock})
    values = np.array([p.value for p in made.parameters]) * MG
    bias, drift, cosine, sine = values.reshape(4, 3)
    log = replace(recorded(50), start_ns=int((start + later) * 10**9))
    t = np.arange(50.0) + later
    angle = 2.0 * np.pi * (22.0 * 3600.0 + 800.0 + t) / 86400.0
    by_day = np.cos(angle)[:, None] * cosine + np.sin(angle)[:, None] * sine
    expected = log.channels["acc"].values - bias - by_day - (t / 600.0 - 0.5)[:, None] * drift
    found = apply_to_recording(made, log).channels["acc"].values
    np.testing.assert_allclose(found, expected, atol=1e-9)
