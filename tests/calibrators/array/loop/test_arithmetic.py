"""What the array's search is made of, in small sums: neighbours, clocks, simulated logs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibrators.array.loop.ages import Ages, beats
from imucalib.calibrators.array.simulation import (
    LogPlan,
    MotionPlan,
    simulated_log,
    simulated_samples,
)
from imucalib.estimators.array.sample_age import SampleAge, fit_sample_age
from worlds.twisted_board import BOARD

DEG = np.pi / 180.0


def test_a_beat_is_the_steady_part_of_a_sawtooth() -> None:
    t = 3.0 + np.arange(0.0, 20.0, 0.01)
    turns = -0.7 * (t - 3.0) + 0.3 + 0.05 * np.sin(2.0 * np.pi * t / 10.0)
    wave = np.stack([turns - np.floor(turns) - 0.5, np.zeros(t.size)], axis=1)
    clock = SampleAge(wave, np.array([-0.7, np.nan]), np.zeros(2))
    one, none = beats(Ages(wave, np.ones(t.size, bool), clock), t)
    assert none is None
    assert one is not None
    assert one.frequency == pytest.approx(-0.7, abs=0.002)
    assert one.phase == pytest.approx(0.3, abs=0.03)
    assert one.at == 3.0
    assert one.wander == pytest.approx(0.05 / np.sqrt(2.0), rel=0.15)


@pytest.mark.parametrize("frequency", [1.3, -0.8])
def test_the_ages_of_readings_are_told_from_what_they_are_late_by(frequency: float) -> None:
    """Off by -a dω/dt, a a sawtooth of 2 ms; a delay of the gyro's own beside it is no beat."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 20.0, 0.01)
    slope = 300.0 * np.stack([np.sin(w * t + p) for w, p in ((7.0, 0.0), (11.0, 1.0), (5.0, 2.0))],
                             axis=1)  # fmt: skip
    turns = frequency * t + 0.2
    wave = turns - np.floor(turns) - 0.5
    off = np.zeros((t.size, 2, 3))
    off[:, 0] = -(2e-3 * wave + 1e-3)[:, None] * slope
    off += 0.003 * rng.standard_normal(off.shape)
    found = fit_sample_age(t, off, slope, np.arange(5, t.size - 5))
    assert found.frequency[0] == pytest.approx(frequency, abs=0.01)
    assert np.isnan(found.frequency[1])
    assert not found.wave[:, 1].any()
    assert found.line[0] > 30.0 > found.line[1]
    away = np.mod(found.wave[:, 0] - wave + 0.5, 1.0) - 0.5
    assert np.median(np.abs(away)) < 0.03


def test_simulated_samples_scatter_as_the_paper_plans_them() -> None:
    """Forces of a rigid body in random motion; gyros as good as the mean of all."""
    r = 0.02 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    plan = MotionPlan(samples=3000, sigma=0.04, sigma_gyro=0.06)
    data = simulated_samples(r, plan, np.random.default_rng(0))
    assert data.rate.std() == pytest.approx(1000.0 * DEG, rel=0.03)
    np.testing.assert_allclose(data.rate_precision, np.eye(3) * 4.0 / (0.06 * DEG) ** 2)
    np.testing.assert_allclose(data.sigma, 0.04)
    # What places the rates leave of the differences is dω/dt and noise: three unknowns a sample.
    w = data.rate
    out = np.cross(w[:, None], np.cross(w[:, None], r))
    rest = (data.acceleration - out) - (data.acceleration - out)[:, :1]
    skew = np.concatenate([np.array([np.cross(e, p) for e in np.eye(3)]).T for p in r[1:]])
    spin = np.linalg.lstsq(skew, rest[:, 1:].reshape(3000, 9).T, rcond=None)[0].T
    assert spin.std() == pytest.approx(35_000.0 * DEG, rel=0.03)
    left = rest[:, 1:].reshape(3000, 9) - spin @ skew.T
    assert 0.04 < left.std() < 0.1
    assert (data.acceleration - out)[:, 0].std() == pytest.approx(20.0, rel=0.03)


def test_a_simulated_log_rests_and_twists_as_planned() -> None:
    plan = LogPlan(poses=4, pose_seconds=2.0, seconds=30.0, twist=300.0, gyro_gain=0.0, gain=0.0,
                   planted={"gyro_scale": 0.1, "gyro_delay": 0.02})  # fmt: skip
    made = simulated_log(BOARD, plan, np.random.default_rng(2))
    one = made.recording.channels[f"{BOARD.imus[0]}/acceleration"]
    rate = made.recording.channels[f"{BOARD.imus[0]}/angular_rate"]
    assert len(one.t) == 38 * 100
    rests = one.values[:800].reshape(4, 200, 3)
    np.testing.assert_allclose(rests.std(axis=1), 0.04, rtol=0.2)
    size = np.linalg.norm(rests.mean(axis=1), axis=1)
    np.testing.assert_allclose(size, 9.80665, atol=1.0)  # biases of 0.3 m/s²
    turning = rate.values[900:3700]
    assert turning.std() == pytest.approx(1.1 * 300.0 * DEG, rel=0.1)
    away = made.positions - (BOARD.positions - BOARD.positions[0])
    assert away[1:].std() == pytest.approx(2.8e-4, rel=0.4)
    same = simulated_log(BOARD, replace(plan, planted={}), np.random.default_rng(2))
    plain = same.recording.channels[f"{BOARD.imus[0]}/angular_rate"].values
    bias = plain[:800].mean(axis=0)
    late = 1.1 * (plain[900:3600] - bias)
    found = rate.values[900:3600] - rate.values[:800].mean(axis=0)
    np.testing.assert_allclose(found[2:], late[:-2], atol=0.05)
