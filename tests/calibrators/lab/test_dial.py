"""What the inclination dial is off by, planted in plain numpy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imucalib.calibrators.lab.calibrate import LabSettings
from imucalib.calibrators.lab.dial import dial_of_fit, dial_words
from imucalib.calibrators.lab.files import LabFiles, calibrate_files
from imucalib.calibrators.lab.request import LabRequest
from worlds.sheets import direction


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
    at = np.radians([-50.0, 0.0, 50.0, 90.0])
    found = dial_of_fit(run.result.final, at)
    np.testing.assert_allclose(found.shift, 1.2, atol=4.0 * found.sd.max())
    assert found.sd.max() < 0.1
    assert (found.half > 1.9 * found.sd).all()
    (zero,) = (k for k, p in enumerate(run.result.final.parameters) if p.name.startswith("incl"))
    assert found.sd[1] == pytest.approx(run.result.final.sd[zero], rel=1e-3)
    assert dial_words(run.result).startswith("Inclination on this bench is the dial plus 1.")
