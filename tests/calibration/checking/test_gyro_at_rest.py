"""A gyroscope at rest: Student's t of two samples whose scatter the rests of one tell."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from imucalib.calibration.checking.misfit import gyro_rest
from imucalib.units import DEG


def test_p_is_that_of_the_axis_that_moved_most_of_three() -> None:
    rng = np.random.default_rng(2)
    rate = rng.normal(size=(9, 3)) * [0.1, 0.2, 0.1] + [0.0, 0.1, 0.25]
    triad = SimpleNamespace(rate=lambda v: v - 0.05 * DEG)
    seen = np.concatenate([DEG * rate[:4], np.full((1, 3), np.nan), DEG * rate[4:]])
    found = gyro_rest(triad, seen, {"count": 20.0})  # type: ignore[arg-type]
    assert found is not None
    moved = rate - 0.05
    np.testing.assert_allclose(found.bias, moved.mean(axis=0))
    sd = np.std(moved, axis=0, ddof=1) * np.sqrt(1.0 / 9.0 + 1.0 / 20.0)
    np.testing.assert_allclose(found.sd, sd)
    each = 2.0 * stats.t.sf(np.abs(moved.mean(axis=0)) / sd, 8)
    assert found.p == pytest.approx(min(1.0, 3.0 * each.min()))
    again = gyro_rest(triad, DEG * (0.1 - rate), {"count": 20.0})  # type: ignore[arg-type]
    assert again is not None
    assert again.p == pytest.approx(found.p)  # of either sign
    # Of a calibration that does not say how many rests it had: as many as are seen.
    alone = gyro_rest(triad, seen, {})  # type: ignore[arg-type]
    assert alone is not None
    np.testing.assert_allclose(alone.sd, np.std(moved, axis=0, ddof=1) * np.sqrt(2.0 / 9.0))
    assert gyro_rest(triad, seen[:2], {}) is None  # type: ignore[arg-type]
    assert gyro_rest(triad, seen[:3], {}) is not None  # type: ignore[arg-type]
