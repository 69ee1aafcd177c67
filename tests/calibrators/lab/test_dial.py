"""What the inclination dial is off by, planted in plain numpy."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.calibrators.lab import dial
from imucalib.calibrators.lab.calibrate import LabSettings
from imucalib.calibrators.lab.dial import Dial, dial_of


def test_rivals_share_the_dial_by_their_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mixture's mean, and its variance by that within and between (the law of total
    variance)."""
    others = {
        "a": Dial(np.array([1.2, 1.0]), np.array([0.5, 0.2]), np.array([1.0, 0.5])),
        "b": Dial(np.array([0.2, 3.0]), np.array([0.1, 0.6]), np.array([0.3, 1.2])),
        "c": Dial(np.array([1.5, 2.5]), np.array([0.3, 0.5]), np.array([0.6, 1.1])),
    }
    monkeypatch.setattr(dial, "dial_of_fit", lambda fit, *at: others[fit])
    weights = {"a": 0.5, "b": 0.3, "c": 0.2}
    group = tuple(SimpleNamespace(weight=w, fit=name) for name, w in weights.items())
    result = SimpleNamespace(final="a", rivals=group, settings=LabSettings())
    found = dial_of(result, np.zeros(2))  # type: ignore[arg-type]
    mean = sum(w * others[n].shift for n, w in weights.items())
    between = sum(w * others[n].shift ** 2 for n, w in weights.items()) - mean**2
    within = sum(w * others[n].sd ** 2 for n, w in weights.items())
    wide = sum(w * others[n].half ** 2 for n, w in weights.items())
    np.testing.assert_allclose(found.shift, mean)
    np.testing.assert_allclose(found.sd, np.sqrt(within + between))
    np.testing.assert_allclose(found.half, np.sqrt(wide + 1.96**2 * between))
