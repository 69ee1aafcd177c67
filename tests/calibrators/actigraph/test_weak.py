"""Few postures, and two sensors in one recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.calibrators.actigraph.observations import (
    NINE,
    base_fit,
    from_data,
    is_weak,
    observations_of,
)
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.actigraph.run import run_of
from imucalib.calibrators.actigraph.series import exchange_in
from imucalib.core.model import Model
from imucalib.effects import named
from imucalib.errors import Undetermined, UnreadableInput
from imucalib.rests.runs import PostureRuns, posture_runs, scan
from imucalib.units import STANDARD_GRAVITY
from worlds.week import Week, WeekPlan, code_steps, simulated_blocks, simulated_week

G = STANDARD_GRAVITY
MODEL = Model(tuple(named(name) for name in NINE))
TYPICAL = np.array([50.0] * 3 + [0.03] * 3 + [0.02] * 3)


def short(rng: np.random.Generator, n: int) -> tuple[Week, Array]:
    """A few postures of a sensor drawn from what data sheets let one expect, and its truth."""
    truth = TYPICAL * rng.standard_normal(9)
    sensor = {name: tuple(truth[3 * k : 3 * k + 3]) for k, name in enumerate(NINE)}
    plan = WeekPlan(days=0.05, sensor=sensor, scatter=float(rng.uniform(0.4, 1.5)))
    week = simulated_week(plan, int(rng.integers(1 << 30)))
    rows = np.sort(rng.choice(week.runs.n, n, replace=False))
    runs = week.runs
    few = replace(runs, mean=runs.mean[rows], windows=runs.windows[rows], time=runs.time[rows],
                  temperature=runs.temperature[rows])  # fmt: skip
    return replace(week, runs=few), truth


@pytest.mark.slow
@pytest.mark.parametrize("n", [1, 4, 9, 12])
def test_stated_uncertainty_covers_with_few_postures(n: int) -> None:
    rng = np.random.default_rng(n)
    z, weak = [], 0
    for _ in range(60):
        week, truth = short(rng, n)
        found, _ = base_fit(MODEL, observations_of(week.runs, week.scanned, G), week.runs)
        assert found.converged
        weak += is_weak(found)
        z.append((found.theta - truth) / found.sd)
    assert weak >= (40 if n < 12 else 1)
    assert 0.85 < np.std(z) < 1.15
    assert np.abs(np.mean(z)) < 0.15


def test_one_posture_moves_only_what_it_shows() -> None:
    week, _ = short(np.random.default_rng(0), 1)
    up = replace(week.runs, mean=G * np.array([[0.0, 0.0, 1.02]]))
    found, _ = base_fit(MODEL, observations_of(up, week.scanned, G), up)
    share = dict(zip([p.name for p in found.parameters], from_data(found), strict=True))
    assert share["bias_z"] > 0.5
    assert 0.1 < share["scale_z"] < 0.5
    assert all(v < 0.01 for k, v in share.items() if k not in ("bias_z", "scale_z"))
    # The prior shares 20 mg out by variances: 50 mg of bias against 30 mg of scale at 1 g.
    assert found.theta[2] / 50.0**2 == pytest.approx(1e3 * found.theta[5] / 30.0**2, rel=0.05)
    assert found.theta[2] + 1e3 * found.theta[5] == pytest.approx(20.0, abs=1.0)


def test_a_posture_alone_says_first_what_to_do_and_no_number_against_itself() -> None:
    week, _ = short(np.random.default_rng(0), 1)
    up = replace(week.runs, mean=G * np.array([[0.0, 0.0, 1.02]]))
    told = run_of(up, week.scanned, ActigraphRequest(), lambda _: None).outcome
    assert str(told.advice[0]).startswith("Rest the sensor for ten seconds with x up, x down")
    assert "the held-out error of 20.00 mg is above the field's 10 mg" in told.reasons
    assert "worse" not in " ".join(told.reasons)  # 20.00 mg as it came


OTHER = {
    "bias": (-10.0, 30.0, 5.0),
    "scale": (-0.02, 0.01, 0.03),
    "non_orthogonality": (-0.01, 0.004, 0.015),
}
WHEN = 1.4 * 86400.0


def two_sensors(seed: int, at: float = WHEN) -> PostureRuns:
    """Three days of one sensor, with another one's readings from a moment on."""
    one = simulated_week(WeekPlan(days=3.0), seed)
    two = simulated_week(WeekPlan(days=3.0, sensor=OTHER), seed)
    late = one.runs.time >= at
    return replace(one.runs, mean=np.where(late[:, None], two.runs.mean, one.runs.mean))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("day", [0.3, 1.4, 2.6])
def test_the_moment_of_an_exchange_is_named(seed: int, day: float) -> None:
    runs = two_sensors(seed, day * 86400.0)
    found = exchange_in(runs)
    assert found is not None
    before = runs.time[runs.time < day * 86400.0][-1]
    after = runs.time[runs.time >= day * 86400.0][0]
    assert before - 3600.0 < found.time < after + 3600.0


@pytest.mark.parametrize(
    "plan",
    [
        WeekPlan(),
        WeekPlan(scatter=3.0),
        WeekPlan(plant={"bias_step@302400s": (25.0, -20.0, 15.0)}),
        WeekPlan(plant={"bias_drift": (60.0, 40.0, -50.0)}),
        WeekPlan(plant={"scale_drift": (0.02, -0.015, 0.01)}),
        WeekPlan(plant={"temperature_bias": (3.0, -3.0, 2.0)}),
        WeekPlan(curve=code_steps(5.0)),
        WeekPlan(days=0.15),
    ],
)
def test_one_sensor_with_errors_is_no_exchange(plan: WeekPlan) -> None:
    for seed in range(3):
        assert exchange_in(simulated_week(plan, seed).runs) is None


def test_two_sensors_are_refused_and_their_parts_calibrated() -> None:
    runs, scanned = two_sensors(1), simulated_week(WeekPlan(days=3.0), 1).scanned
    with pytest.raises(Undetermined, match="another sensor") as caught:
        run_of(runs, scanned, ActigraphRequest(loop=False), lambda _: None)
    assert "--every 33." in caught.value.remedy
    assert "1 d 09:" in caught.value.what
    every = ActigraphRequest(loop=False, every=33.6 * 3600.0)
    run = run_of(runs, scanned, every, lambda _: None)
    assert run.series is not None
    first, second = (part.fit for part in run.series.parts[:2])
    assert first is not None
    assert second is not None
    assert np.allclose(first.theta[:3], (25.0, -40.0, 15.0), atol=1.0)
    assert np.allclose(second.theta[:3], OTHER["bias"], atol=1.0)
    assert any("another sensor" in reason for reason in run.outcome.reasons)


@pytest.mark.parametrize("factor", [2.0, 0.5, 1.0 / 9.80665])
@pytest.mark.parametrize("day", [0.1, 0.3])
def test_a_change_of_range_is_named(factor: float, day: float) -> None:
    blocks = []
    for block in simulated_blocks(WeekPlan(days=0.5, rate=20.0), 3):
        channel = block.channels["imu0/acceleration"]
        values = np.where((channel.t >= day * 86400.0)[:, None], factor, 1.0) * channel.values
        changed = replace(channel, values=values)
        blocks.append(replace(block, channels={"imu0/acceleration": changed}))
    with pytest.raises(UnreadableInput, match="range or the unit changes") as caught:
        posture_runs(scan(blocks, 10.0))
    hour = float(caught.value.what.partition("before ")[2].partition(" h")[0])
    assert abs(hour - 24.0 * day) < 0.2
    assert "two files" in caught.value.remedy
