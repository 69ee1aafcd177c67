"""Numbers that a calibration writes, each by its own definition: matrices and their sds, what may
hide, what lies beyond the calibrated range, and the tables by which a recording is corrected."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.calibration import power
from imucalib.calibration.calibration import Calibration, StoredParameter, matrices
from imucalib.calibration.correction import Correction
from imucalib.calibration.outcome import Left, Limit
from imucalib.calibration.series import CalibrationPart, part_at
from imucalib.core.context import Context
from imucalib.core.model import Model
from imucalib.effects import named
from imucalib.recording.recording import Channel, Recording
from imucalib.units import MG, STANDARD_GRAVITY

G = STANDARD_GRAVITY


def test_matrices_are_the_linear_part_and_its_scatter() -> None:
    """raw = S a + c, corrected = M raw + b; lengths of S's rows and angles between them; sds as
    draws of the parameters scatter. What is curved or needs a covariate is left out."""
    rng = np.random.default_rng(0)
    names = ("mounting", "bias", "scale", "non_orthogonality", "quadratic", "temperature_bias")
    model = Model(tuple(named(n) for n in names))
    size = np.array([1.0] * 3 + [30.0] * 3 + [0.02] * 3 + [0.01] * 3 + [2.0] * 3 + [0.5] * 3)
    theta = size * rng.normal(size=18)
    root = 1e-2 * np.diag(size) @ rng.normal(size=(18, 18)) / 4.0
    found = matrices(model, theta, root @ root.T)
    linear = Model(tuple(named(n) for n in names[:4]))
    force = 9.0 * rng.normal(size=(7, 3))
    raw = linear.predict(theta[:12], force[:, None], Context(7)).reading[:, 0]
    np.testing.assert_allclose(raw @ found.M.T + found.b, force, atol=1e-9)
    np.testing.assert_allclose(force @ found.S.T + found.c, raw, atol=1e-9)

    def told(values: np.ndarray) -> np.ndarray:
        predicted = linear.predict(values, np.zeros((1, 1, 3)), Context(1))
        s, c = predicted.d_truth[0, 0], predicted.reading[0, 0]
        unit = [row / np.sqrt(row @ row) for row in s]
        angle = [np.degrees(np.arccos(unit[i] @ unit[j])) for i, j in ((0, 1), (0, 2), (1, 2))]
        m = np.linalg.inv(s)
        return np.concatenate([m.ravel(), -m @ c, s.ravel(), np.sqrt(np.sum(s**2, axis=1)),
                               angle, c / MG])  # fmt: skip

    value = [found.M.ravel(), found.b, found.S.ravel(), found.scale, found.angle, found.bias_mg]
    np.testing.assert_allclose(np.concatenate(value), told(theta[:12]))
    drawn = np.array([told(v[:12]) for v in theta + rng.normal(size=(800, 18)) @ root.T])
    sd = [found.M_sd.ravel(), found.b_sd, found.S_sd.ravel(), found.scale_sd, found.angle_sd,
          found.bias_mg_sd]  # fmt: skip
    np.testing.assert_allclose(np.concatenate(sd), drawn.std(axis=0), rtol=0.12)


def score(name: str, size: float, strength: float, *, absorbed: bool) -> SimpleNamespace:
    return SimpleNamespace(name=name, size=size, strength=strength, absorbed=absorbed)


def test_what_may_hide_is_told_at_the_size_that_four_of_five_would_find() -> None:
    """4.7 times the noise of its own size; what gravity cannot show at its typical size; nothing
    below a tenth of a mg."""
    scores = [
        score("cubic", 2.0 * MG, 9.4, absorbed=False),
        score("quadratic", 0.5 * MG, 0.0, absorbed=True),
        score("asymmetry", 3.0 * MG, 1.0, absorbed=False),
        score("hysteresis", 1.0 * MG, 48.0, absorbed=False),
        score("cross_axis", 3.0 * MG, 1.0, absorbed=False),
        score("inclination_zero", 9.0 * MG, 1.0, absorbed=True),
        score("bias_step@60s", 9.0 * MG, 1.0, absorbed=False),
    ]
    found = power.hidden(scores, ("cross_axis",))  # type: ignore[arg-type]
    assert [h.name for h in found] == ["quadratic", "asymmetry", "cubic"]
    assert [h.size / MG for h in found] == pytest.approx([0.5, 14.1, 1.0])
    (text,) = power.advice_of(found)
    assert "cannot show quadratic, whatever the size (0.5 mg rms" in text
    assert power.advice_of(found[1:]) == ()


def corrected(order: np.ndarray, values: np.ndarray | None = None) -> tuple[str, ...]:
    """Notes of a calibration at 20 to 30 °C that is applied at some temperatures."""
    names = (("temperature_bias", "mg/°C"), ("quadratic", "mg/g2"))
    stored = tuple(StoredParameter(f"{n}_{a}", n, "sensor", 0.1, 0.1, u)
                   for n, u in names for a in "xyz")  # fmt: skip
    made = Calibration(
        calibrator="lab", parameters=stored, covariance=np.eye(6), raw_unit="m/s2", raw_to_si=1.0,
        gravity=G, status="ok", reasons=(), valid={"temperature": (20.0, 30.0)},
    )  # fmt: skip
    one = Correction(made)
    n = len(order)
    force = np.tile([0.0, 0.0, G], (n, 1)) if values is None else values
    t = np.arange(float(n))
    channel = Channel(t, force, "m/s2", "acceleration", "imu0", 1.0)
    warm = Channel(t, order[:, None], "degC", "temperature", "imu0", 1.0)
    one(Recording({}, "", "", ""), channel, None, warm)
    return one.notes


def test_a_sample_is_outside_from_a_tenth_of_the_range_on() -> None:
    assert corrected(np.array([19.01, 25.0, 30.99])) == ()
    (note,) = corrected(np.array([18.9, 25.0, 31.1, 40.0]))
    assert note.startswith("3 of 4 samples lie outside the calibrated temperature, 20 to 30 °C")
    assert "18.9 to 40 °C were recorded" in note
    far = np.array([[1.09 * G, 0, 0], [1.11 * G, 0, 0], [0, -1.11 * G, 0], [0, 0, 1.11 * G]])
    (note,) = corrected(np.full(4, 25.0), far)
    assert note.startswith("3 of 4 samples read more than 1.1 g")


def test_the_part_of_a_time_is_the_last_that_has_begun() -> None:
    parts = tuple(CalibrationPart(s, s + 10.0, None) for s in (5.0, 15.0, 25.0))  # type: ignore[arg-type]
    at = part_at(parts, np.array([0.0, 5.0, 14.9, 15.0, 99.0]))
    assert at.tolist() == [0, 0, 0, 1, 2]


def test_limits_and_what_is_left() -> None:
    assert not Limit("x", 1.0, 1.0, "mg").broken
    assert Limit("x", 1.001, 1.0, "mg").broken
    assert Limit("x", np.nan, 1.0, "mg").broken
    assert not Left("x", 1.0, 1.0, "mg").beyond
    assert Left("x", 1.001, 1.0, "mg").beyond
