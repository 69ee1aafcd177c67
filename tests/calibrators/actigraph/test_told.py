"""What a worn sensor's report says, each number by hand: what was recorded, how far errors go over
the sphere, what runs count, whether parts differ, and the paper's own figures."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from imucalib.calibrators.actigraph import coverage, errors
from imucalib.calibrators.actigraph.observations import (
    covariates_of,
    observations_of,
    quantisation,
    robust_fit,
)
from imucalib.calibrators.actigraph.published import (
    PointCollector,
    published_still,
    two_sets,
)
from imucalib.calibrators.actigraph.simulation import (
    WeekPlan,
    scan_of,
    simulated_blocks,
    simulated_week,
)
from imucalib.core.model import Model
from imucalib.effects import named
from imucalib.rests.runs import PostureRuns, Scan
from imucalib.units import MG, STANDARD_GRAVITY

Array = NDArray[np.float64]
G = STANDARD_GRAVITY
NINE = ("bias", "scale", "non_orthogonality")


def runs_of(n: int = 6, **changed: object) -> PostureRuns:
    u = np.concatenate([np.eye(3), -np.eye(3)])[np.arange(n) % 6]
    made: dict[str, object] = {
        "mean": G * u, "windows": np.arange(1, n + 1), "time": 3600.0 * np.arange(n),
        "temperature": np.full(n, np.nan), "window_noise": 3.0 * MG, "still": 21, "total": 100,
        "noise": np.full(3, 2.0 * MG), "resolution": np.zeros(3),
    }  # fmt: skip
    return PostureRuns(**{**made, **changed})  # type: ignore[arg-type]


def scanned(seconds: float, **changed: object) -> Scan:
    made = scan_of(np.zeros(0), None, rate=25.0, seconds=seconds)
    return Scan(**{**vars(made), **changed})  # type: ignore[arg-type]


def test_a_runs_noise_is_that_of_its_windows_beside_a_milli_g() -> None:
    data = observations_of(runs_of(), scanned(6 * 3600.0), G, blocks=3)
    np.testing.assert_allclose(data.sigma[:, 0, 0] / MG, np.sqrt(1.0 + 9.0 / np.arange(1.0, 7.0)))
    # Three stretches of equal time between the first run and the last.
    assert data.group.tolist() == [0, 0, 1, 1, 2, 2]
    assert data.label[1] == "run at 0 d 01:00"


def test_a_step_is_an_error_only_where_noise_does_not_average_it_out() -> None:
    """Step / √12 of an axis whose noise is below half a step."""
    coarse = runs_of(noise=np.array([1.9, 2.1, 2.1]) * MG, resolution=np.full(3, 4.0 * MG))
    assert quantisation(coarse) == pytest.approx(4.0 * MG / np.sqrt(36.0))
    assert quantisation(runs_of(noise=np.full(3, 2.0 * MG), resolution=np.full(3, 4.0 * MG))) == 0.0
    data = observations_of(coarse, scanned(6 * 3600.0), G)
    assert data.sigma[0, 0, 0] / MG == pytest.approx(np.sqrt(1.0 + 16.0 / 36.0 + 9.0))


def test_what_effects_may_depend_on_is_there_where_it_varies() -> None:
    n = 6
    found = covariates_of(runs_of(), scanned(10 * 3600.0))
    np.testing.assert_allclose(found["order"], np.arange(n) / 10.0)
    np.testing.assert_allclose(found["previous_x"], G * np.array([1.0, 1.0, 0.0, 0.0, -1.0, 0.0]))
    assert "time_of_day" not in found
    assert "temperature" not in found
    long = covariates_of(runs_of(), scanned(1.6 * 86400.0, start_ns=6 * 3600 * 10**9))
    np.testing.assert_allclose(long["time_of_day"], 2.0 * np.pi * (6.0 + np.arange(n)) / 24.0)
    assert "time_of_day" not in covariates_of(runs_of(), scanned(1.4 * 86400.0))
    grid = np.arange(0.0, 36000.0, 60.0)
    for swing, there in ((0.99, False), (1.0, True)):
        warm = scan_of(grid, 20.0 + grid, rate=25.0, seconds=36000.0)
        runs = runs_of(temperature=20.0 + swing * np.arange(n) / (n - 1.0))
        assert ("temperature" in covariates_of(runs, warm)) == there


def fitted_nine(seed: int = 1) -> tuple[object, PostureRuns, Scan]:
    week = simulated_week(WeekPlan(days=0.4, temperature=False), seed)
    data = observations_of(week.runs, week.scanned, G)
    model = Model(tuple(named(name) for name in NINE))
    return robust_fit(model, data, week.runs)[0], week.runs, week.scanned


def test_coverage_is_what_was_recorded() -> None:
    found, runs, scan = fitted_nine()
    result = SimpleNamespace(runs=runs, final=found, light=3)
    block = coverage.coverage_of(result, scan, gravity=G, window=10.0)  # type: ignore[arg-type]
    said = block.as_dict()
    assert said["hours"] == pytest.approx(9.6)
    assert said["still_hours"] == pytest.approx(runs.still / 360.0)
    assert (said["windows"], said["still_windows"], said["posture_runs"]) == (
        runs.total, runs.still, runs.n)  # fmt: skip
    assert said["runs_that_count_less"] == 3
    np.testing.assert_allclose(said["noise_of_a_sample_mg"], 4.0)
    assert said["axis_range_g"]["y"] == pytest.approx(
        [runs.mean[:, 1].min() / G, runs.mean[:, 1].max() / G]
    )
    assert "temperature_degC" not in said
    # |a| is known by the parameters: draws of them move the corrected norm as much.
    rng = np.random.default_rng(0)
    theta = rng.multivariate_normal(found.theta, found.covariance, 4000)  # type: ignore[attr-defined]
    u = np.array([0.6, 0.0, 0.8])
    reading = found.model.predict(found.theta, G * u[None, None], _one()).reading[0, 0]  # type: ignore[attr-defined]
    size = [np.linalg.norm(_undone(t, reading)) for t in theta]
    assert errors.norm_sd(found, u[None])[0] == pytest.approx(np.std(size), rel=0.06)  # type: ignore[arg-type]
    assert block.worst_sd >= block.mean_sd > 0.0


def _one() -> object:
    from imucalib.core.effect import Context

    return Context(1)


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
            assert cell.raw == cell.held_out == pytest.approx(own.mean())
            assert cell.base == cell.final == pytest.approx(final.mean())
        else:
            assert np.isnan(cell.raw)
        assert cell.sd > 0.0
    summary = errors.error_summary(found, found, held, held)  # type: ignore[arg-type]
    assert (
        summary.raw
        == summary.held_out.final
        == pytest.approx(np.mean(np.abs(np.linalg.norm(runs.mean, axis=1) - G)) / MG)
    )
    sigma = found.noise.factor * found.observations.sigma[:, 0, 0]  # type: ignore[attr-defined]
    # Mean of |normal|.
    assert summary.floor == pytest.approx(sigma.mean() / MG * np.sqrt(2.0 / np.pi))


def test_the_papers_rule_of_stillness_and_its_points() -> None:
    """max - min below 0.12 g on one axis, and not a stuck one; ends of axes come first."""
    low = np.zeros((4, 3))
    high = np.array([[0.119, 9, 9], [0.121, 9, 9], [0.0, 9, 9], [0.01, 9, 9]]) * G
    assert published_still(SimpleNamespace(low=low, high=high), G).tolist() == [0, 3]  # type: ignore[arg-type]
    one = PointCollector(1, 1)
    assert one.offer(np.array([-0.76, 0.1, 0.1]))
    assert one.missing[0] == "y near -1 g"
    assert not one.offer(np.array([-0.74, 0.3, 0.3]))
    points = np.concatenate([np.eye(3), -np.eye(3), np.zeros((3, 3))])
    first, second = two_sets(np.tile(points, (2, 1)), 1, 1)
    assert first.ready
    assert second.ready
    assert len(first.points) == len(second.points) == 9


def test_a_simulated_week_is_as_long_as_asked_and_rests_as_much() -> None:
    week = simulated_week(WeekPlan(days=2.0, rests=0.6, plant={}), 4)
    assert week.runs.n == int(0.6 * 2.0 * 86400.0 / 120.0)
    assert week.scanned.stop == 2.0 * 86400.0
    time = week.runs.time
    # Uniform over the whole recording.
    assert stats.kstest(time / (2.0 * 86400.0), "uniform").pvalue > 1e-3
    assert week.runs.windows.mean() == pytest.approx(13.0, abs=1.0)
    np.testing.assert_allclose(np.linalg.norm(week.force, axis=1), G)
    left = np.linalg.norm(
        np.array([_undone(np.concatenate(list(week.plan.sensor.values())), v)
                  for v in week.runs.mean]) - week.force, axis=1)  # fmt: skip
    sd = np.sqrt(0.4**2 + 16.0 / (10.0 * 100.0) / week.runs.windows)
    assert np.mean((left / MG / sd) ** 2) == pytest.approx(3.0, rel=0.1)


def test_samples_of_a_simulated_day_are_its_sensors() -> None:
    """Rests read the planted sensor's forward model with the noise asked for; the share of time at
    rest is that asked for."""
    plan = WeekPlan(days=0.5, rate=2.0, rests=0.6, noise=4.0)
    values = np.concatenate([b.channels["imu0/acceleration"].values
                             for b in simulated_blocks(plan, 1, block=3600.0)])  # fmt: skip
    assert len(values) == 0.5 * 86400 * 2
    part = values.reshape(12, 30, 240, 3)
    spread = part.std(axis=2).mean(axis=2).ravel() / MG
    still = spread < 20.0
    assert still.mean() == pytest.approx(0.6, abs=0.07)
    assert np.median(spread[still]) == pytest.approx(4.0, rel=0.05)
    assert np.median(spread[~still]) == pytest.approx(124.0, rel=0.05)
    theta = np.concatenate([plan.sensor[name] for name in NINE])
    rest = part.mean(axis=2).reshape(-1, 3)[still]
    size = np.array([np.linalg.norm(_undone(theta, v)) for v in rest])
    np.testing.assert_allclose(size, G, atol=2.0 * MG)
