"""Wear, activity and the field's rule, against the same written a second time in numpy."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.calibrators.actigraph import wear
from imucalib.calibrators.actigraph.closest_point import closest_point
from imucalib.calibrators.actigraph.wear import Minutes, Wear, activity_of, minutes_of, wear_of
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.runs import Scan, scan
from imucalib.units import MG, STANDARD_GRAVITY

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
    channel = Channel(t, reading * STANDARD_GRAVITY, "m/s2", "acceleration", "imu0", RATE)
    return Recording({"imu0/acceleration": channel}, "log", "csv", "0" * 64)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return log()


@pytest.fixture(scope="module")
def scanned(recording: Recording) -> Scan:
    return scan([recording], 10.0)


def test_hours_off_the_body_are_found(scanned: Scan) -> None:
    wear = wear_of(scanned)
    assert wear.hours == pytest.approx(HOURS, abs=0.02)
    ((start, stop),) = wear.off
    assert start == pytest.approx(7200.0, abs=900.0)
    assert stop == pytest.approx(14400.0, abs=900.0)
    assert wear.worn == pytest.approx(4.0, abs=0.3)
    assert list(wear.worn_at(np.array([0.0, 10000.0, 20000.0]))) == [True, False, True]


def test_the_fields_rule_finds_what_was_planted(scanned: Scan) -> None:
    rule = closest_point(scanned)
    assert rule is not None
    assert rule.enough
    np.testing.assert_allclose(rule.scale, SCALE, atol=5e-4)
    np.testing.assert_allclose(rule.offset, OFFSET, atol=5e-4)
    assert rule.after < 0.5 < rule.before
    corrected = SCALE * (scanned.windows.mean / STANDARD_GRAVITY + OFFSET)
    expected = np.linalg.norm(corrected, axis=1) - 1.0
    np.testing.assert_allclose(
        rule.norm_error(scanned.windows.mean) / STANDARD_GRAVITY, expected, atol=2e-3
    )


def test_what_bends_counts_in_enmo_at_the_mean_of_its_minute(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of samples that stand still for a minute that is exact."""

    def bent(_: object, x: np.ndarray) -> np.ndarray:
        return 1.02 * x + 0.1 + 0.004 * x**2 * np.sign(x)

    monkeypatch.setattr(wear, "corrected_by", bent)
    rng = np.random.default_rng(3)
    u = rng.standard_normal((5, 3))
    each = 1.03 * STANDARD_GRAVITY * u / np.linalg.norm(u, axis=1, keepdims=True)
    values = np.repeat(each, 60, axis=0)
    channel = Channel(np.arange(300.0), values, "m/s2", "acceleration", "imu0", 1.0)
    made = minutes_of([Recording({"a": channel}, "", "", "")], "imu0", None)  # type: ignore[arg-type]
    assert made.minute.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert made.count.tolist() == [60.0] * 5
    for found, reading in ((made.raw, each), (made.corrected, bent(None, each))):
        over = np.linalg.norm(reading, axis=1) - STANDARD_GRAVITY
        assert (over > 0.0).all()
        np.testing.assert_allclose(found, over)


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
    assert found.night == pytest.approx((22.5 * 3600, 3.5 * 3600))
    assert found.enmo["night"] == pytest.approx((2.0, 1.0))
    assert found.enmo["day"] == pytest.approx((40.0, 20.0))
    assert found.night_runs == 1
    assert found.night_error == pytest.approx((4.0, 1.0))
    few = Minutes(minute[:600], minutes.count[:600], minutes.raw[:600], minutes.corrected[:600])
    assert activity_of(few, wear, 0.0, errors, at).night is None
