"""Thermometers: what is believed, and what of the past is find_memory."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.recording.recording import Channel
from imucalib.rests.runs import Scan, posture_runs, scan
from imucalib.rests.thermal import ThermalHistory, believable_windows
from imucalib.rests.windows import WindowBuilder, Windows
from imucalib.units import MG, STANDARD_GRAVITY
from worlds.recordings import recording_of

T = 10.0 * np.arange(2000)
CASE = 30.0 + 3.0 * np.sin(T / 3000.0)


def windows(values: Array, t: Array = T) -> Windows:
    builder = WindowBuilder(1)
    builder.add(Channel(t, values[:, None], "degC", "temperature", "imu0", 0.1), ())
    found = builder.windows()
    assert found is not None
    return found


def noisy(values: Array) -> Array:
    return np.asarray(values + 0.1 * np.random.default_rng(1).standard_normal(values.size))


@pytest.mark.parametrize("value", [85.0, -127.0, 20.0, np.nan])
def test_readings_that_jump_and_come_back_are_left_out(value: float) -> None:
    values = noisy(CASE)
    at = np.append([0, 700, 701, 1999], np.random.default_rng(2).integers(0, 2000, 40))
    values[at] = value
    found, words = believable_windows(windows(values))
    assert found is not None
    assert np.array_equal(found.time, np.delete(T, at))
    assert len(found.gone) == np.unique(at).size
    assert words[0].startswith(f"temperature: {np.unique(at).size} of 2000 readings left out")


def scanned(values: Array) -> Scan:
    """Rests of 60 s in postures of their own, a movement of 40 s before each."""
    rng = np.random.default_rng(4)
    n = 200
    x = rng.standard_normal((n, 3))
    g = np.repeat(x / np.linalg.norm(x, axis=1, keepdims=True), 1000, axis=0)
    moves = np.arange(len(g)) % 1000 < 400
    g += np.where(moves[:, None], 0.2, 0.003) * rng.standard_normal(g.shape)
    t = 0.1 * np.arange(len(g))
    return scan([recording_of(t, MG * np.round(1e3 * g), warm=(T, values), hz=10.0)], 10.0)


def test_a_rest_has_the_temperature_of_its_good_readings_or_is_left_out() -> None:
    values = noisy(CASE)
    values[4:10], values[16] = np.nan, 85.0  # all of the first rest, one window of the second
    found, good = posture_runs(scanned(values)), posture_runs(scanned(noisy(CASE)))
    assert (found.n, good.n) == (199, 200)
    assert np.array_equal(found.mean, good.mean[1:])
    assert np.allclose(found.temperature, good.temperature[1:], atol=0.2)
    assert found.notes == ("1 of 200 posture runs left out: they have no temperature",)
    assert abs(float(np.median(np.linalg.norm(found.mean, axis=1))) / STANDARD_GRAVITY - 1) < 0.01


@pytest.mark.parametrize(("step", "shown"), [(0.1, True), (3.0, False)])
def test_a_rounded_thermometer_shows_no_short_lag(step: float, shown: bool) -> None:
    """What half an hour's lag smoothed were the steps of 3 °C: a plain bias was surely one."""
    warm, _ = believable_windows(windows(step * np.round(noisy(CASE) / step)))
    assert warm is not None
    assert warm.shows(warm.lagged(0.5, T), warm.values) == shown


def behind(values: np.ndarray, width: float) -> np.ndarray:
    at, found = values[0], []
    for value in values:
        at = min(max(at, value - width / 2.0), value + width / 2.0)
        found.append(at)
    return np.array(found)


@pytest.mark.parametrize("n", [1, 2, 3, 50, 1025])
def test_a_play_moves_only_at_its_ends(n: int) -> None:
    values = 30.0 + np.cumsum(np.random.default_rng(n).standard_normal(n))
    history = ThermalHistory(10.0 * np.arange(n), values)
    for width in (0.5, 2.0, 6.0):
        got = history.within_play(width, history.time)
        np.testing.assert_allclose(got, behind(values, width), atol=1e-12)
