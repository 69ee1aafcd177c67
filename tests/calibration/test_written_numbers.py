"""Numbers that a calibration writes, each by its own definition: matrices and their sds, what may
hide, what lies beyond the calibrated range, and the tables by which a recording is corrected."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.calibration import power
from imucalib.calibration.calibration import matrices
from imucalib.core.effect import Context
from imucalib.core.model import Model
from imucalib.effects import named
from imucalib.units import MG


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
