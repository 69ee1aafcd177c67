"""What a worn sensor's report says, each number by hand, and the days that are simulated for it."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.calibrators.actigraph import errors
from imucalib.calibrators.actigraph.observations import (
    observations_of,
    robust_fit,
)
from imucalib.calibrators.actigraph.wear import (
    Minutes,
    Wear,
    activity_of,
    closest_point,
    minutes_of,
    wear_of,
)
from imucalib.core.model import Model
from imucalib.effects import named
from imucalib.estimators.least_squares import fit
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.runs import PostureRuns, Scan, scan
from imucalib.units import MG, STANDARD_GRAVITY
from worlds.bench import SIGMA, base_model, draw, tumble
from worlds.recordings import recording_of
from worlds.week import WeekPlan, simulated_week

G = STANDARD_GRAVITY
NINE = ("bias", "scale", "non_orthogonality")


def fitted_nine(seed: int = 1) -> tuple[object, PostureRuns, Scan]:
    week = simulated_week(WeekPlan(days=0.4, temperature=False), seed)
    data = observations_of(week.runs, week.scanned, G)
    model = Model(tuple(named(name) for name in NINE))
    return robust_fit(model, data, week.runs)[0], week.runs, week.scanned


def _undone(theta: Array, reading: Array) -> Array:
    gain = np.eye(3) + np.diag(theta[3:6])
    gain[[1, 2, 2], [0, 0, 1]] = theta[6:]
    return np.linalg.solve(gain, reading - MG * theta[:3])


def test_errors_over_the_sphere_are_those_of_the_nearest_part() -> None:
    """Six ends and eight corners; a part without a posture has no error, but a deviation."""
    found, runs, _ = fitted_nine()
    held = errors.raw_errors(found)  # type: ignore[arg-type]
    np.testing.assert_allclose(held.error[:, 0, 0], np.linalg.norm(runs.mean, axis=1) - G)
    cells = errors.sphere_cells(found, found, held)  # type: ignore[arg-type]
    names = ["+x", "-x", "+y", "-y", "+z", "-z"]
    assert [c.name for c in cells[:6]] == names
    assert (cells[6].name, cells[13].name) == ("+x+y+z", "-x-y-z")
    assert sum(c.runs for c in cells) == runs.n
    corrected = np.array([_undone(found.theta, v) for v in runs.mean])  # type: ignore[attr-defined]
    u = corrected / np.linalg.norm(corrected, axis=1)[:, None]
    signs = [np.array([a, b, c]) / 3**0.5 for a in (1, -1) for b in (1, -1) for c in (1, -1)]
    centres = np.array([s * np.eye(3)[k] for k in range(3) for s in (1, -1)] + signs)
    near = np.argmax(u @ centres.T, axis=1)
    for k, cell in enumerate(cells):
        own = np.abs(np.linalg.norm(runs.mean[near == k], axis=1) - G) / MG
        final = np.abs(np.linalg.norm(corrected[near == k], axis=1) - G) / MG
        assert cell.runs == own.size
        if own.size:
            assert cell.raw_mg == cell.held_out_mg == pytest.approx(own.mean())
            assert cell.base_mg == cell.final_mg == pytest.approx(final.mean())
        else:
            assert np.isnan(cell.raw_mg)
        assert cell.sd_mg > 0.0
    summary = errors.error_summary(found, found, held, held)  # type: ignore[arg-type]
    assert (
        summary.raw
        == summary.held_out.final
        == pytest.approx(np.mean(np.abs(np.linalg.norm(runs.mean, axis=1) - G)) / MG)
    )
    sigma = found.noise.factor * found.observations.sigma[:, 0, 0]  # type: ignore[attr-defined]
    # Mean of |normal|.
    assert summary.floor == pytest.approx(sigma.mean() / MG * np.sqrt(2.0 / np.pi))


RATE, HOURS = 5.0, 6
SCALE, OFFSET = np.array([1.01, 0.985, 1.004]), np.array([0.02, -0.03, 0.01])


def log(seed: int = 0) -> Recording:
    """Postures of three minutes with movement between; from 2 h to 4 h off the body."""
    rng = np.random.default_rng(seed)
    n = int(3600 * RATE)
    t = np.arange(HOURS * n) / RATE
    posture = (t // 180).astype(int)
    v = rng.standard_normal((posture.max() + 1, 3))
    truth = (v / np.linalg.norm(v, axis=1, keepdims=True))[posture]
    moving = (t % 180) < 40
    truth = truth + np.where(moving, rng.normal(0.0, 0.2, t.size), 0.0)[:, None]
    off = (t >= 2 * 3600) & (t < 4 * 3600)
    truth[off] = [0.0, 0.0, 1.0]
    reading = truth / SCALE - OFFSET + rng.normal(0.0, 0.001, truth.shape)
    return recording_of(t, reading * STANDARD_GRAVITY, hz=RATE)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return log()


@pytest.fixture(scope="module")
def wear_scanned(recording: Recording) -> Scan:
    return scan([recording], 10.0)


def test_hours_off_the_body_are_found(wear_scanned: Scan) -> None:
    wear = wear_of(wear_scanned)
    assert wear.hours == pytest.approx(HOURS, abs=0.02)
    ((start, stop),) = wear.off
    assert start == pytest.approx(7200.0, abs=900.0)
    assert stop == pytest.approx(14400.0, abs=900.0)
    assert wear.worn == pytest.approx(4.0, abs=0.3)
    assert list(wear.worn_at(np.array([0.0, 10000.0, 20000.0]))) == [True, False, True]


def test_the_fields_rule_finds_what_was_planted(wear_scanned: Scan) -> None:
    rule = closest_point(wear_scanned)
    assert rule is not None
    assert rule.enough
    np.testing.assert_allclose(rule.scale, SCALE, atol=5e-4)
    np.testing.assert_allclose(rule.offset_g, OFFSET, atol=5e-4)
    assert rule.error_after_mg < 0.5 < rule.error_before_mg
    corrected = SCALE * (wear_scanned.windows.mean / STANDARD_GRAVITY + OFFSET)
    expected = np.linalg.norm(corrected, axis=1) - 1.0
    np.testing.assert_allclose(
        rule.norm_error(wear_scanned.windows.mean) / STANDARD_GRAVITY, expected, atol=2e-3
    )


@pytest.mark.parametrize("effect", ["temperature_bias", "bias_drift", "bias_step@1800s"])
def test_activity_is_that_of_samples_with_every_effect_undone(effect: str) -> None:
    """What lies still has no activity, be its bias what it may be with temperature or time."""
    blank, model = tumble(3), base_model((*NINE, effect))
    typical = np.array([p.typical for p in model.parameters(blank.context)])
    data = draw(model, 4.0 * typical, blank, 4)
    found = fit(model, data)
    t = np.add.outer(data.context["time"], np.linspace(0.0, 1.0, 10)).ravel()
    reading = np.repeat(data.reading[:, 0], 10, axis=0)
    channel = Channel(t, reading, "m/s2", "acceleration", "wrist", 10.0)
    block = Recording({"wrist/acceleration": channel}, "made", "made", "")
    minutes = minutes_of([block], "wrist", found)
    assert minutes.raw.mean() > 2.0 * MG
    assert minutes.corrected.max() < 2.0 * SIGMA


def test_night_is_the_least_active_part_of_the_clock() -> None:
    """Two days whose five hours from 22:30 are quiet; the recording starts at 6 o'clock."""
    minute = np.arange(2 * 1440.0)
    clock = (minute / 60.0 + 6.0) % 24.0
    quiet = (clock >= 22.5) | (clock < 3.5)
    value = np.where(quiet, 1.0, 20.0) * MG
    minutes = Minutes(minute, np.full(minute.size, 60.0), 2.0 * value, value)
    wear = Wear(48.0, 48.0, np.empty((0, 2)))
    at = np.array([17.0, 40.0, 3.0]) * 3600.0  # 23:00, 22:00 and 9:00
    errors = np.array([4.0, 9.0, 9.0]) * MG, np.array([-1.0, 5.0, 5.0]) * MG
    found = activity_of(minutes, wear, 6.0 * 3600.0, errors, at)
    assert found.night_s_of_day == pytest.approx((22.5 * 3600, 3.5 * 3600))
    assert tuple(vars(found.enmo_mg["night"]).values()) == pytest.approx((2.0, 1.0))
    assert tuple(vars(found.enmo_mg["day"]).values()) == pytest.approx((40.0, 20.0))
    assert found.night_posture_runs == 1
    assert tuple(vars(found.night_error_mg).values()) == pytest.approx((4.0, 1.0))
    few = Minutes(minute[:600], minutes.count[:600], minutes.raw[:600], minutes.corrected[:600])
    assert activity_of(few, wear, 0.0, errors, at).night_s_of_day is None
