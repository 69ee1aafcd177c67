"""What decides a rest, limit by limit, on windows that are made by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from imucalib.rests.candidates import (
    Noise,
    colour_of,
    is_noise,
    whiteness,
)
from imucalib.rests.runs import Scan, grouped
from imucalib.rests.stillness import Sensor
from imucalib.rests.windows import Windows

Array = NDArray[np.float64]
G = 9.80665
MG = 1e-3 * G


def windows(mean: Array, sd: Array | float = 1e-3, **changed: object) -> Windows:
    """Half a second each at 100 Hz, one after the other, of readings (m, 3)."""
    m = len(mean)
    spread = np.broadcast_to(np.asarray(sd, float), (m, 3)).copy()
    made: dict[str, object] = {
        "samples": 50, "first": 50 * np.arange(m), "run": np.zeros(m, np.intp),
        "start": 0.5 * np.arange(m), "stop": 0.5 * np.arange(m) + 0.49, "mean": mean,
        "variance": spread**2, "low": mean - 2.0 * spread, "high": mean + 2.0 * spread,
        "finest": np.full(3, np.inf),
    }  # fmt: skip
    return Windows(**{**made, **changed})  # type: ignore[arg-type]


def level(m: int) -> Array:
    return np.tile([0.0, 0.0, G], (m, 1))


def sensor(w: Windows, quantity: str = "acceleration", quietest: float = 0.01) -> Sensor:
    return Sensor("imu0", quantity, 100.0, w, quietest)


def test_the_colour_of_noise_is_what_means_scatter_more() -> None:
    """Square root of the variance of neighbours' means over that of white noise, 1 to 3."""
    rng = np.random.default_rng(0)
    for factor in (1.0, 2.0, 9.0):
        mean = level(3000) + factor * MG / np.sqrt(50.0) * rng.standard_normal((3000, 3))
        found = colour_of(sensor(windows(mean, MG)), np.ones(3000, bool))
        assert found == pytest.approx(min(factor, 3.0), rel=0.06)
    few = windows(level(10), MG)
    assert colour_of(sensor(few), np.ones(10, bool)) == 1.0
    # Steps beside which the noise disappears count for it: variances of step²/12 each.
    still = windows(level(40) + 0.5 * rng.standard_normal((40, 3)) * MG, 1e-9,
                    finest=np.full(3, 12.0 * MG))  # fmt: skip
    assert colour_of(sensor(still), np.ones(40, bool)) == pytest.approx(1.0, abs=0.3)
    assert Noise(np.array([2.0]), 1.5).of_mean(9)[0] == pytest.approx(1.0)


def test_whiteness_is_von_neumanns_ratio() -> None:
    rng = np.random.default_rng(0)
    values = rng.standard_normal((400, 3))
    steps = np.mean(np.diff(values, axis=0) ** 2, axis=0) / 2.0 / values.var(axis=0)
    assert whiteness(values) == pytest.approx(steps.min())
    assert whiteness(np.cumsum(values, axis=0)) < 0.1
    assert whiteness(np.ones((5, 3))) == 1.0
    assert is_noise(0.61, 1.2)
    assert not is_noise(0.59, 1.2)
    assert is_noise(0.31, 0.5)
    assert not is_noise(0.29, 0.5)


def scanned(w: Windows, warm: Windows | None = None) -> Scan:
    return Scan(w, warm, "imu0", 100.0, 450, 4.5, 0, "", "", "", 0, ())


def test_a_run_is_the_mean_of_its_windows() -> None:
    """Its noise by the differences of neighbours' sizes: their median square over 0.4549 and 2."""
    w = windows(level(9), MG, finest=np.array([0.1, np.inf, 0.2]))
    w.mean[:, 2] += MG * np.array([0, 3, 0, 3, 0, 3, 0, 3, 0.0])
    w.mean[6:, :] = w.mean[6:, [2, 1, 0]]
    warm = replace(windows(np.zeros((9, 1))), mean=20.0 + np.arange(9.0)[:, None])
    found = grouped(scanned(w, warm), np.arange(9), np.full(3, MG))
    assert found.windows.tolist() == [6, 3]
    np.testing.assert_allclose(found.mean, [[0, 0, G + 1.5 * MG], [G + MG, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(found.time, [1.495, 3.745])
    np.testing.assert_allclose(found.temperature, [22.5, 27.0])
    scatter = 3.0 * MG / np.sqrt(2.0 * stats.chi2.median(1))
    assert found.window_noise == pytest.approx(scatter, rel=1e-3)
    assert (found.still, found.total) == (9, 9)
    assert found.resolution.tolist() == [0.1, 0.0, 0.2]
    still = grouped(scanned(windows(level(9), MG)), np.arange(9), np.full(3, MG))
    assert still.window_noise == pytest.approx(MG / np.sqrt(50.0))
    assert np.isnan(still.temperature).all()
