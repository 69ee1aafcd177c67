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
    drift_of,
    is_noise,
    whiteness,
)
from imucalib.rests.runs import Scan, grouped
from imucalib.rests.stillness import Sensor
from imucalib.rests.thermal import ThermalHistory, history_of
from imucalib.rests.windows import Windows

Array = NDArray[np.float64]
G = 9.80665
MG = 1e-3 * G
DEG = np.pi / 180.0


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


def ramp(far: float, m: int = 40, length: float = 60.0, axis: int = 0) -> Array:
    """Means of a level sensor one axis of which goes evenly over `far` shares of gravity."""
    means = level(m)
    means[:, axis] += far * G * (np.arange(m) - 0.5 * (m - 1)) / (m - 1)
    return means


QUIET = Noise(np.full(3, 1e-9), 1.0)


@pytest.mark.parametrize(
    ("far", "seconds", "turning"),
    [
        (np.sin(0.3 * DEG) + 1e-4 - 1e-5, 60.0, False),
        (np.sin(0.3 * DEG) + 1e-4 + 1e-5, 60.0, True),  # and 0.1 mg a minute
        (2.4e-3, 2.0, False),  # fast, but short
        (2.6e-3, 2.0, True),
        (np.sin(0.025 * DEG) * 10.0 * 0.99, 10.0, False),
        (np.sin(0.025 * DEG) * 10.0 * 1.01, 10.0, True),
    ],
)
def test_a_turn_goes_too_far_or_too_fast(far: float, seconds: float, turning: bool) -> None:
    means = ramp(far if seconds > 20.0 else far * 39.0 / 40.0, length=seconds)
    found = drift_of(means, 50, QUIET, seconds)
    assert found.turning == turning
    # Means of the last and of the first three tenths.
    assert found.size == pytest.approx(np.ptp(means[:, 0]), rel=1e-4)
    assert drift_of(means[:1], 50, QUIET, seconds) == drift_of(means, 50, QUIET, 0.0)


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


def test_a_lag_is_an_exponential_of_its_hours() -> None:
    """After a step: 1 - exp(-t / τ), in equilibrium before."""
    t = np.arange(0.0, 7200.0, 10.0)
    warm = ThermalHistory(t, np.where(t >= 1000.0, 30.0, 20.0))
    at = np.array([500.0, 1000.0 + 1800.0, 1000.0 + 3600.0])
    due = 20.0 + 10.0 * (1.0 - np.exp(-np.array([0.0, 1800.0, 3600.0]) / 1800.0))
    np.testing.assert_allclose(warm.lagged(0.5, at), due, atol=0.06)
    w = replace(windows(np.array([[21.0], [22.0]])), start=np.array([0.0, 10.0]),
                stop=np.array([8.0, 18.0]))  # fmt: skip
    assert history_of(w).time.tolist() == [4.0, 14.0]
