"""What decides a rest, limit by limit, on windows that are made by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from imucalib.recording.recording import Channel, Gap
from imucalib.rests import edges, stillness
from imucalib.rests.candidates import Seen
from imucalib.rests.drift import (
    Noise,
    colour_of,
    drift_of,
    far_apart,
    is_noise,
    parts_of,
    whiteness,
)
from imucalib.rests.grouping import groups_of
from imucalib.rests.levels import Kinds, steady_windows
from imucalib.rests.postures import postures_begin
from imucalib.rests.runs import Scan, grouped
from imucalib.rests.samples import Samples
from imucalib.rests.stillness import Sensor, StillSettings, allowed
from imucalib.rests.tails import Tail, overlapping, with_tails
from imucalib.rests.thermal_history import ThermalHistory, history_of, temperature_at
from imucalib.rests.windows import Windows, breaks, in_order

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


def kinds(still: Array, **changed: Array) -> Kinds:
    none = np.zeros(len(still), bool)
    made = {n: none for n in ("louder", "other", "shaking", "slow", "spiky")}
    return Kinds(still=np.asarray(still, bool), notes=(), **{**made, **changed})


def test_noise_is_told_from_the_quiet_windows() -> None:
    """The median of those within three times the variance of the quietest; at least step / √12."""
    sd = np.concatenate([np.full(20, 1.0), np.full(30, 1.3), np.full(50, 9.0)])[:, None] * MG
    w = windows(level(100), sd * np.ones(3))
    np.testing.assert_allclose(sensor(w).noise / MG, 1.3)
    coarse = replace(w, finest=np.full(3, 12.0 * MG))
    np.testing.assert_allclose(sensor(coarse).noise / MG, np.sqrt(12.0))
    assert sensor(w).step.tolist() == [0.0] * 3


@pytest.mark.parametrize(
    ("quiet", "steps", "fine"),
    [(0, 1.0, True), (40, 1.0, False), (40, 2.9, False), (40, 3.1, True)],
)
def test_a_resolution_hides_a_noise_below_it(quiet: int, steps: float, fine: bool) -> None:
    """Where single axes stand still in more windows that are quiet beside the step, three of it at
    most, than all of them move in."""
    noise = np.where(np.arange(60) < quiet, steps, 1.0)[:, None] * MG
    w = windows(level(60), noise, finest=np.full(3, MG))
    high = w.high.copy()
    high[:quiet, 1] = w.low[:quiet, 1]
    still = replace(w, high=high, low=w.low.copy())
    # The extreme of the whole recording is a clipped axis, not a coarse one.
    still.low[-1] -= 100.0
    still.high[-1] += 100.0
    assert sensor(still).fine == fine
    assert sensor(replace(still, finest=np.full(3, np.inf))).fine


def test_what_a_sensor_at_rest_may_do() -> None:
    w = windows(level(40), 1.0 * MG)
    settings = StillSettings(sway=2.4 * MG, turning=0.05, variance_ratio=4.0)
    np.testing.assert_allclose(allowed(sensor(w), settings), np.hypot(1.0, 2.4) * MG)
    slow = windows(np.zeros((40, 3)), 0.01)
    np.testing.assert_allclose(allowed(sensor(slow, "angular_rate"), settings), 0.025)
    fast = windows(np.zeros((40, 3)), 0.03)
    np.testing.assert_allclose(allowed(sensor(fast, "angular_rate"), settings), 0.03)


@pytest.mark.parametrize(
    ("sd", "reach", "still"),
    [(1.9, 8, True), (2.1, 8, False), (1.5, 9.9, True), (1.5, 10.1, False)],
)
def test_a_still_window_has_four_times_the_variance_and_ten_times_the_range_at_most(
    sd: float, reach: float, still: bool
) -> None:
    w = windows(level(60), 1.0 * MG)
    w.variance[30, 1] = (sd * MG) ** 2
    w.high[30, 1] = w.low[30, 1] + reach * MG
    found, notes = stillness.still_windows(sensor(w), StillSettings())
    assert found[30] == still
    assert found.sum() == 59 + still
    assert not notes


def test_frozen_samples_are_told_in_seconds_with_the_windows_beside_them() -> None:
    w = windows(level(60), 1.0 * MG)
    low, high = w.low.copy(), w.high.copy()
    low[20:23] = high[20:23] = w.mean[20:23]
    variance = w.variance.copy()
    variance[20:23] = 0.0
    frozen = replace(w, low=low, high=high, variance=variance)
    found, notes = stillness.still_windows(sensor(frozen), StillSettings())
    assert np.flatnonzero(~found).tolist() == [19, 20, 21, 22, 23]
    assert notes == ["imu0/acceleration: 2.5 s of frozen samples left out of the rests"]
    parted = replace(frozen, run=(np.arange(60) > 22).astype(np.intp))
    found, _ = stillness.still_windows(sensor(parted), StillSettings())
    assert np.flatnonzero(~found).tolist() == [
        19, 20, 21, 22
    ]  # fmt: skip


def test_an_axis_at_the_recordings_extreme_is_clipped() -> None:
    w = windows(level(60), 1.0 * MG)
    w.low[30, 0] = w.high[30, 0] = 9.0  # above all others, while y and z move
    w.mean[30, 0] = 9.0
    found, notes = stillness.still_windows(sensor(w), StillSettings())
    assert np.flatnonzero(~found).tolist() == [30]
    assert "0.5 s of clipped" in notes[0]


def test_gravity_is_the_median_size() -> None:
    w = windows(np.concatenate([level(6), 3.0 * level(4)]))
    assert stillness.gravity_of(sensor(w), np.ones(10, bool)) == pytest.approx(G)
    assert stillness.gravity_of(sensor(w), np.arange(10) > 5) == pytest.approx(3.0 * G)
    np.testing.assert_allclose(stillness.loudest(sensor(w), np.ones(10, bool)), 0.03 * G)
    coarse = replace(w, finest=np.full(3, 0.2))
    np.testing.assert_allclose(stillness.loudest(sensor(coarse), np.ones(10, bool)), 0.4)
    rate = stillness.loudest(sensor(w, "angular_rate"), np.ones(10, bool))
    assert np.isinf(rate).all()


@pytest.mark.parametrize(
    ("ratio", "errors", "steady"),
    [(3.9, 0.0, True), (4.1, 0.0, False), (1.0, 3.9, True), (1.0, 4.1, False)],
)
def test_steady_windows_are_alike_in_variance_and_in_mean(
    ratio: float, errors: float, steady: bool
) -> None:
    w = windows(level(4), 1.0)
    w.variance[1] = ratio
    w.mean[1, 0] += errors * np.sqrt((1.0 + ratio) / 50.0)
    w.mean[2:, 1] += 99.0
    w.mean[3:, 1] += 99.0
    found = steady_windows(w, np.zeros(3), np.zeros(4, bool))
    assert found.tolist() == [steady, steady, False, False]
    apart = replace(w, run=np.array([0, 1, 1, 1]))
    assert not steady_windows(apart, np.zeros(3), np.zeros(4, bool)).any()


def test_the_last_samples_of_a_run_are_a_window_of_it() -> None:
    """Windows at 0 to 2 s, at 10 to 12 s; a run from 5 s that is shorter than a window has none."""
    w = windows(level(8), start=np.array([0.0, 0.5, 1.0, 1.5, 10.0, 10.5, 11.0, 11.5]),
                run=np.repeat([3, 5], 4))  # fmt: skip
    rng = np.random.default_rng(0)
    made = [
        Tail(begin, at + 0.01 * np.arange(50), rng.normal(size=(50, 3)))
        for begin, at in ((0.0, 1.7), (5.0, 5.1), (10.0, 11.6), (-3.0, -2.0))
    ]
    found = with_tails(w, made)
    assert found.start.tolist() == [
        -2.0, 0.0, 0.5, 1.0, 1.5, 1.7, 5.1, 10.0, 10.5, 11.0, 11.5, 11.6,
    ]  # fmt: skip
    assert found.run.tolist() == [-4, 3, 3, 3, 3, 3, -2, 5, 5, 5, 5, 5]
    assert np.flatnonzero(found.first < 0).tolist() == [0, 5, 6, 11]
    for place, tail in zip((5, 6, 11, 0), made, strict=True):
        assert found.stop[place] == tail.t[-1]
        np.testing.assert_allclose(found.mean[place], tail.values.mean(axis=0))
        np.testing.assert_allclose(found.variance[place], tail.values.var(axis=0, ddof=1))
        np.testing.assert_allclose(found.low[place], tail.values.min(axis=0))
        np.testing.assert_allclose(found.high[place], tail.values.max(axis=0))
    assert with_tails(w, ()) is w


def test_a_window_beside_one_at_rest_is_steady_wherever_the_recording_began() -> None:
    """Alike its neighbour at rest, which is no other kind of window for it."""
    w = windows(level(4), 1.0)
    w.mean[0] += 99.0
    w.mean[3] -= 99.0
    for first in (True, False):
        still = np.array([first, False, True, False])
        assert steady_windows(w, np.zeros(3), still).tolist() == [False, True, False, False]
    assert not steady_windows(w, np.zeros(3), np.array([False, True, True, False])).any()


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


@pytest.mark.parametrize(("errors", "turning"), [(6.4, False), (6.6, True)])
def test_noise_is_no_drift(errors: float, turning: bool) -> None:
    """Between the highest and the lowest of many means 6.5 standard errors beyond what is allowed;
    what is told of it is five less."""
    error = 0.1 * MG
    noise = Noise(np.full(3, error * np.sqrt(50.0)), 1.0)
    means = level(40)
    means[7, 0] += (np.sin(0.3 * DEG) + 1e-4 / 60.0 * 2.0) * G + errors * error
    found = drift_of(means, 50, noise, 2.0)
    assert found.turning == turning
    assert found.size == pytest.approx(np.ptp(means[:, 0]) - 5.0 * error)


def test_a_rate_counts_where_it_is_sure() -> None:
    """Five standard errors of a least-squares line."""
    m, seconds = 40, 10.0
    t = (np.arange(m) - 0.5 * (m - 1)) * seconds / m
    rate = 2.0 * np.sin(0.025 * DEG) * G
    for factor, turning in ((5.05, True), (4.95, False)):
        error = abs(rate) / factor * np.sqrt(np.sum(t * t))
        noise = Noise(np.full(3, error * np.sqrt(50.0) / 1.5), 1.5)
        means = level(m)
        means[:, 1] += rate * t
        assert drift_of(means, 50, noise, seconds).turning == turning


def test_windows_far_apart_belong_to_no_rest() -> None:
    for extra, far in ((-1e-6, False), (1e-6, True)):
        w = windows(level(11))
        seconds = w.stop[9] - w.start[2]
        w.mean[5, 1] += (np.sin(0.3 * DEG) + 1e-4 / 60.0 * seconds) * G
        w.mean[5, 1] += 6.5 * MG / np.sqrt(50.0) + extra
        assert far_apart(w, np.arange(2, 10), np.full(3, MG)) == far


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


def test_parts_are_a_quarter_second_or_a_hundred_and_twentieth() -> None:
    for n, rate, each in ((1000, 100.0, 25), (40_000, 100.0, 334), (60, 100.0, 20), (2, 100.0, 1)):
        means, found = parts_of(np.arange(3.0 * n).reshape(n, 3), rate)
        assert (found, len(means)) == (each, n // each)
        np.testing.assert_allclose(means[0], [1.5 * (each - 1) + k for k in range(3)])


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


def test_groups_part_at_a_jump_a_gap_and_a_moving_window() -> None:
    """A mean may change by the noise and six standard errors of the difference, a thousandth of
    gravity in any case."""
    noise = MG
    limit = max(noise + 6.0 * noise * np.sqrt(2.0 / 50.0), 1e-3 * G)
    for extra, count in ((-1e-6, 1), (1e-6, 2)):
        w = windows(level(30), noise)
        w.mean[15:, 0] += limit + extra
        still = np.ones(30, bool)
        # What is within ten deviations is a jump still, where it does not go further than a rest.
        found = groups_of(sensor(w), kinds(still), StillSettings())
        assert len(found) == count
    gap = replace(windows(level(30), noise), run=(np.arange(30) > 9).astype(np.intp))
    found = groups_of(sensor(gap), kinds(np.ones(30)), StillSettings())
    assert [g.windows.size for g in found] == [
        10, 20
    ]  # fmt: skip
    moving = kinds(np.arange(30) != 12)
    found = groups_of(sensor(windows(level(30), noise)), moving, StillSettings())
    assert [g.windows.size for g in found] == [12, 17]
    none = groups_of(sensor(windows(level(30), noise)), kinds(np.zeros(30)), StillSettings())
    assert none == []
    loud = kinds(np.ones(30), louder=np.arange(30) > 13)
    (one,) = groups_of(sensor(windows(level(30), noise)), loud, StillSettings())
    assert one.louder
    loud = kinds(np.ones(30), louder=np.arange(30) > 15)
    (one,) = groups_of(sensor(windows(level(30), noise)), loud, StillSettings())
    assert not one.louder


def test_short_pieces_of_a_slow_motion_wander() -> None:
    """Groups of less than five seconds, in a chain that goes further than a rest may."""
    for step, wandering in ((4.0, True), (1.5, False)):
        w = windows(level(12), MG)
        w.mean[:, 0] += step * MG * (np.arange(12) // 3)
        found = groups_of(sensor(w), kinds(np.ones(12)), StillSettings())
        assert any(g.wandering for g in found) == (wandering and len(found) >= 1)


def seen(w: Windows, quantity: str = "acceleration", usual: float = 1.0) -> Seen:
    spans = [edges.Span(0, 200, 0.0, 1.99, False, False), edges.Span(300, 600, 3.0, 5.99, True,
                                                                     False)]  # fmt: skip
    return Seen(sensor(w, quantity), kinds(np.ones(12)), spans, 1.0, usual)


def held(values: Array) -> Samples:
    made = Samples()
    made.begin_block(())
    t = np.arange(len(values)) / 100.0
    made.add(("acceleration", "imu0"), Channel(t, values, "m/s2", "acceleration", "imu0", 100.0))
    return made


def test_a_posture_ends_at_twenty_milli_g_or_thirty_from_its_start() -> None:
    w = windows(level(9))
    w.mean[3:, 0] += 19.0 * MG
    assert postures_begin(w, np.arange(9)).tolist() == [0]
    w.mean[3:, 0] += 2.0 * MG
    assert postures_begin(w, np.arange(9)).tolist() == [0, 3]
    slow = windows(level(9))
    slow.mean[:, 0] += 8.0 * MG * np.arange(9)
    assert postures_begin(slow, np.arange(9)).tolist() == [0, 4, 8]
    assert postures_begin(windows(level(9)), np.array([0, 1, 3, 4])).tolist() == [0, 2]
    parted = replace(windows(level(9)), run=np.arange(9) // 5)
    assert postures_begin(parted, np.arange(9)).tolist() == [0, 5]


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


def test_windows_whose_time_steps_back_are_left_out() -> None:
    w = replace(windows(level(5)), start=np.array([0.0, 0.5, 0.2, 1.0, 1.4]),
                stop=np.array([0.4, 0.9, 0.6, 1.4, 1.9]))  # fmt: skip
    kept, lost = in_order(w)
    assert kept.start.tolist() == [0.0, 0.5, 1.0]
    assert lost == 2
    assert overlapping(w, np.array([0, 1, 3, 4])).tolist() == [4]


def test_a_run_breaks_at_gaps_and_where_time_steps_back() -> None:
    t = np.array([0.0, 1.0, 2.0, 5.0, 6.0, 3.6, 4.0])
    assert breaks(t, [Gap(2.0, 5.0, "")]).tolist() == [3, 5]
    assert breaks(t, []).tolist() == [5]
    assert breaks(t[:4], [Gap(6.0, 9.0, ""), Gap(1.0, 1.0, "")]).tolist() == []


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


def test_a_thermometer_that_is_silent_for_an_hour_holds() -> None:
    t = np.array([0.0, 100.0, 3701.0, 3801.0])
    made = Channel(
        t, np.array([[10.0], [20.0], [60.0], [70.0]]), "degC", "temperature", "imu0", 0.0
    )
    at = np.array([50.0, 100.0, 1900.0, 3700.9, 3751.0, 9999.0])
    np.testing.assert_allclose(temperature_at(made, at), [15.0, 20.0, 20.0, 20.0, 65.0, 70.0])
    close = replace(made, t=np.array([0.0, 100.0, 3700.0, 3800.0]))
    np.testing.assert_allclose(temperature_at(close, np.array([1900.0])), [40.0])
