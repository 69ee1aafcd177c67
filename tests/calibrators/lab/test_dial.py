"""What the inclination dial is off by, planted in plain numpy."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.calibrators.lab import dial
from imucalib.calibrators.lab.calibrate import LabSettings
from imucalib.calibrators.lab.conventions import Conventions
from imucalib.calibrators.lab.dial import Dial, dial_of, dial_of_fit, dial_words
from imucalib.calibrators.lab.files import LabFiles, calibrate_files
from imucalib.calibrators.lab.request import LabRequest
from worlds.sheets import direction


@pytest.mark.slow
def test_a_dial_that_shows_too_little_is_told_by_how_much(tmp_path: Path) -> None:
    """The tool stands 1.2 deg steeper than its dial says, at every setting."""
    rng = np.random.default_rng(2)
    k = np.arange(24)
    i, t = np.array([-50.0, 0.0, 40.0, 70.0])[k // 6], 60.0 * (k % 6) + 7.0 * (k // 6)
    u = direction(i + 1.2, t)
    reading = 1000.0 * u * np.array([1.01, 0.99, 1.005]) + np.array([5.0, -8.0, 3.0])
    reading += 0.3 * rng.standard_normal(u.shape)
    rows = np.column_stack([i, t, reading])
    table = tmp_path / "bench.csv"
    np.savetxt(table, rows, delimiter=",", header="inclination,tool_face,x_mg,y_mg,z_mg",
               comments="")  # fmt: skip
    settings = LabSettings(declare=("inclination_zero",), loop=False)
    run = calibrate_files(LabFiles(table), LabRequest(settings=settings), lambda text: None)
    at = np.array([-50.0, 0.0, 50.0, 90.0])
    found = dial_of_fit(run.result.final, at, Conventions())
    np.testing.assert_allclose(found.shift, 1.2, atol=4.0 * found.sd.max())
    assert found.sd.max() < 0.1
    assert (found.half > 1.9 * found.sd).all()
    (zero,) = (k for k, p in enumerate(run.result.final.parameters) if p.name.startswith("incl"))
    assert found.sd[1] == pytest.approx(run.result.final.sd[zero], rel=1e-3)
    assert dial_words(run.result).startswith("Inclination on this bench is the dial plus 1.")


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
