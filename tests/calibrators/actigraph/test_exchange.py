"""Two sensors, or two ranges, in one recording: the moment is named, with what to do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.actigraph.run import run_of
from imucalib.calibrators.actigraph.series import exchange_in
from imucalib.calibrators.actigraph.simulation import (
    WeekPlan,
    code_steps,
    simulated_blocks,
    simulated_week,
)
from imucalib.errors import Undetermined, UnreadableInput
from imucalib.rests.runs import PostureRuns, posture_runs, scan

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
