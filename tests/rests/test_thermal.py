"""Thermometers: what is believed, and what of the past is find_memory."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.runs import Scan, posture_runs, scan
from imucalib.rests.thermal import (
    ThermalHistory,
    believable_windows,
    is_remembered,
    lacks_temperature,
    pair_thermometer,
    remember_in_rows,
    thermal_history,
    thermometer_of,
)
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


def thermometer(t: Array, values: Array, triad: str = "imu0") -> Channel:
    return Channel(t, values[:, None], "degC", "temperature", triad, 1.0)


def jumps(parts: Array, interval: float) -> Array:
    """(m,) of windows (m, w) of readings: the rule once more, window by window."""
    bad = np.array([not np.isfinite(p).all() or p.min() < -55.0 or p.max() > 125.0 for p in parts])
    good, half = parts[~bad], min(max(round(50.0 / interval), 2), 5)
    if len(good) <= 2 * half:
        return bad
    mean = good.mean(axis=1)
    mirrored = np.r_[mean[half:0:-1], mean, mean[-2 : -half - 2 : -1]]
    around = np.array([np.median(mirrored[k : k + 2 * half + 1]) for k in range(len(mean))])
    off = np.abs(good - around[:, None]).max(axis=1)
    apart = min((b - a for a, b in pairwise(sorted(set(mean)))), default=0.0)
    most = min(max(0.2 * interval, 2.0), 30.0)
    bad[~bad] = off > max(most, 8.0 * 1.4826 * float(np.median(off)), 1.5 * apart)
    return bad


@pytest.mark.parametrize("interval", [1.0, 10.0, 30.0, 200.0])
@pytest.mark.parametrize("step", [0.01, 2.0, 6.0])
def test_jumps_are_those_of_the_rule(interval: float, step: float) -> None:
    found = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        m = int(rng.choice([4, 8, 11, 300]))
        parts = 30.0 + 0.01 * np.arange(m)[:, None] + 0.3 * rng.standard_normal((m, 4))
        parts = step * np.round(parts / step)
        at = rng.integers(0, m, m // 12 + 1), rng.integers(0, 4, m // 12 + 1)
        sizes = np.r_[0.3 * np.arange(1, 26), 9.0, 14.0, 28.0, 33.0, 55.0, 94.0, 97.0, -83.0, -87.0]
        parts[at] += step * np.round(rng.choice(sizes, at[0].size) / step)
        parts[: 3 * m // 5 if seed % 10 == 9 else 0] = 300.0
        builder = WindowBuilder(4)
        builder.add(thermometer(0.25 * interval * np.arange(4 * m), parts.ravel()), ())
        w = builder.windows()
        assert w is not None
        history, _ = believable_windows(w)
        bad = jumps(parts, interval)
        assert (history is None) == (2 * bad.sum() > m)
        if history is not None:
            assert np.array_equal(history.time, w.middle[~bad])
            ends = w.middle[bad, None] + 0.5 * interval * np.array([-1.0, 1.0])
            assert history.gone == pytest.approx(ends)
        found.append(bad.any() and not bad.all())
    assert sum(found) > 10


def trailing(t: Array, values: Array, hours: float, step: float) -> Array:
    """A lag on a grid, reading by reading, at t."""
    grid = np.arange(t[0], t[-1] + step, step)
    seen, y = np.interp(grid, t, values), [values[0]]
    for value in seen[1:]:
        y.append(y[-1] + (1.0 - np.exp(-step / (3600.0 * hours))) * (value - y[-1]))
    return np.interp(t, grid, y)


@pytest.mark.parametrize("hours", [0.001, 0.1, 2.0])
def test_a_lag_goes_on_where_readings_are_missing(hours: float) -> None:
    """On a grid of the usual step; a rate too, through what the thermometer did not measure."""
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.choice([10.0, 10.0, 10.0, 500.0, 5000.0], 200))
    values = 25.0 + np.cumsum(rng.standard_normal(200))
    history = ThermalHistory(t, values, np.array([[t[3], t[5]], [t[9], t[10]]]))
    lag = trailing(t, values, hours, 10.0)
    np.testing.assert_allclose(history.lagged(hours, t), lag, rtol=1e-9)
    np.testing.assert_allclose(history.rate(hours, t), (values - lag) / hours, atol=1e-9 / hours)
    assert np.flatnonzero(np.isnan(history.temperature(t))).tolist() == [3, 4, 9]


def of_rows(warm: Array, t: Array | None, session: Array) -> dict[str, Array]:
    """What `remember_in_rows` gives, a session and a row at a time."""
    at = 3600.0 * np.arange(warm.size) if t is None else t
    step = float(np.median(np.abs(np.diff(at))))
    found: dict[str, Array] = {}
    for rows, rate in ((2, False), (4, False), (8, False), (1, True), (3, True)):
        hours = rows * step / 3600.0
        value = f"{rows}rows" if t is None else f"{60 * hours:.2g}min" if rate else f"{hours:.2g}h"
        out = np.empty(warm.size)
        for one in np.unique(session):
            of = session == one
            own = float(np.median(np.diff(at[of])))
            lag = trailing(at[of], warm[of], hours, own)
            out[of] = (warm[of] - lag) / hours if rate else lag
        if rate or (4 * rows <= warm.size and np.corrcoef(out, warm)[0, 1] ** 2 < 0.999):
            found[f"temperature_{'rate' if rate else 'lag'}_{value}"] = out
    for width in (2, 3, 4, 6):
        each = [behind(warm[session == one], width) for one in np.unique(session)]
        out, spread = np.concatenate(each), float(np.std(np.concatenate(each)))
        if 2 * width <= np.ptp(warm) and spread and np.corrcoef(out, warm)[0, 1] ** 2 < 0.97:
            found[f"temperature_play_{width}C"] = out
    return found


@pytest.mark.parametrize("clocked", [False, True])
def test_a_table_remembers_by_rows_or_its_clock(clocked: bool) -> None:
    names = set()
    for seed in range(40):
        rng = np.random.default_rng(seed)
        n = int(rng.choice([7, 15, 31, 32, 80]))
        warm = 25.0 + np.cumsum(rng.standard_normal(n)) * rng.choice([0.3, 1.0])
        warm = np.sort(warm) if seed % 4 == 0 else warm
        t = np.cumsum(rng.uniform(100.0, 900.0, n)) if clocked else None
        session = (np.arange(n) >= n // 2).astype(float) * (seed % 2)
        warm = 20.0 + 5.0 * session if seed % 10 == 9 else warm
        found, own = remember_in_rows(warm, t, session), of_rows(warm, t, session)
        assert set(found) == set(own)
        for name, value in own.items():
            np.testing.assert_allclose(found[name], value, rtol=1e-9, atol=1e-9, err_msg=name)
        names |= set(found)
    assert any("play_4C" in name for name in names)
    assert all(is_remembered(name) == (clocked or "play" in name) for name in names)


def test_where_most_are_jumps_all_is_gone() -> None:
    t = 10.0 * np.arange(100)
    values = np.where(np.arange(100) % 3, 300.0, 25.0)
    one = Recording({"warm": thermometer(t, values)}, "made", "made", "")
    found = thermal_history([one], "imu0")
    assert found is not None
    assert (found.time.size, found.gone.tolist()) == (0, [[-np.inf, np.inf]])


@pytest.mark.parametrize("owners", [("imu0", ""), ("", "imu0"), ("", "imu1"), ("imu1", "")])
def test_the_thermometer_of_a_sensor_comes_before_that_of_none(owners: tuple[str, str]) -> None:
    channels = {f"{k}": thermometer(T, CASE, owner) for k, owner in enumerate(owners)}
    found = thermometer_of(Recording(channels, "made", "made", ""), "imu0")
    assert found is not None
    assert found.triad == ("imu0" if "imu0" in owners else "")


@pytest.mark.parametrize(
    ("first", "every", "waits"),
    [
        (30.0, 60.0, 1),
        (599.0, 600.0, 0),
        (750.0, 1500.0, 3),
        (4500.0, 9000.0, 7),
        (9000.0, 60.0, 7),
    ],
)
def test_a_block_waits_for_the_reading_that_follows_it(
    first: float, every: float, waits: int
) -> None:
    """Blocks of ten minutes, readings of its own pace: an hour is waited, and no reading lost."""
    readings = np.arange(first, 9000.0, every)
    handed = 0

    def blocks() -> Iterator[Recording]:
        nonlocal handed
        for k in range(15):
            handed += 1
            ends = np.array([600.0 * k, 600.0 * k + 599.0])
            force = Channel(ends, np.zeros((2, 3)), "m/s2", "acceleration", "imu0", 1.0)
            own = readings[(readings >= 600.0 * k) & (readings < 600.0 * k + 600.0)]
            channels = {"force": force}
            if own.size:
                channels["warm"] = thermometer(own, own)
            yield Recording(channels, "made", "made", "")

    ahead = []
    for k, (block, track) in enumerate(pair_thermometer(blocks(), "imu0")):
        ahead.append(handed - k - 1)
        begin, end = block.channels["force"].t
        known = np.zeros(0) if track is None else track.t
        near = readings[(readings > begin - every) & (readings < end + every)]
        held = handed == 15 or ahead[-1] * 600.0 < 3600.0
        assert not held or np.isin(near, known).all()
    assert len(ahead) == 15
    assert max(ahead) == waits


def test_a_difference_shows_beyond_twice_the_error_of_rounding() -> None:
    history, off = ThermalHistory(T, CASE, step=0.6), 2.0 * 0.6 / np.sqrt(12.0)
    assert history.shows(CASE, CASE + 1.01 * off)
    assert not history.shows(CASE, CASE - 0.99 * off)


def test_around_a_reading_that_is_gone_there_is_no_temperature() -> None:
    history = ThermalHistory(T, CASE, np.array([[5.0, 15.0]]))
    at = np.array([-1.0, 0.0, 0.1, 9.9, 10.0, 19.9, 20.0, 20.1])
    lost = [False, False, True, True, True, True, False, False]
    assert lacks_temperature(thermometer(T, CASE), history, at).tolist() == lost
