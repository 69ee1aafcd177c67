"""An axis that is noisier than the others is noise: no wrong record, no heavy tail, no effect."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imucalib.calibrators.lab.bench import raw_unit
from imucalib.calibrators.lab.calibrate import LabSettings
from imucalib.calibrators.lab.checks import observations_of
from imucalib.calibrators.lab.errors import reading_noise
from imucalib.calibrators.lab.position_table import read_position_table
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import run_lab
from imucalib.core.context import Context
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.references import KnownVector
from imucalib.effects import named
from imucalib.estimators.least_squares import fit
from imucalib.loop.candidates import record_candidates
from imucalib.loop.noise.axes import doubtful_axes, with_noisy_axes
from imucalib.units import MG, STANDARD_GRAVITY
from worlds.plain_bench import Bench, Plan

BASE = Model(tuple(named(n) for n in ("mounting", "bias", "scale", "non_orthogonality")))


def noisier(path: Path, seed: int, times: tuple[float, float, float], n: int = 40) -> Path:
    """A sheet whose axes have so many times 0.5 mg of noise."""
    bench = Bench(Plan(seed, sigma=1e-6, n=n))
    rng = np.random.default_rng((seed, 9))
    bench.reading = bench.reading + 0.5 * np.array(times) * rng.standard_normal((n, 3))
    return bench.write(path)


def fitted(path: Path) -> Fit:
    table = read_position_table(path)
    request = LabRequest(unit="mg", settings=LabSettings(loop=False))
    raw = raw_unit(table, "mg", None)
    return fit(BASE, observations_of(table, raw, request))


def axes_of(found: Fit) -> set[str]:
    return {noise.name for noise in found.observations.shared}


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_noisier_axis_is_found_with_its_size(tmp_path: Path, axis: int) -> None:
    times = [1.0, 1.0, 1.0]
    times[axis] = 5.0
    found = with_noisy_axes(fitted(noisier(tmp_path / "s.csv", 4, (times[0], times[1], times[2]))))
    assert axes_of(found) == {f"noise of {'xyz'[axis]}"}
    noise = reading_noise(found)
    # 40 readings tell their scatter to 11 %.
    assert noise.axes[axis] / MG == pytest.approx(2.5, rel=0.35)
    assert noise.own == pytest.approx(np.sqrt(np.mean(np.square(noise.axes))))
    # Once more it is the same: what was found is found anew.
    again = with_noisy_axes(found)
    assert axes_of(again) == axes_of(found)
    assert again.log_likelihood == pytest.approx(found.log_likelihood, abs=1e-3)


def test_two_axes_may_be_noisier() -> None:
    """On dials that were set once: settings of each row would stand for two axes of three."""
    rng, n = np.random.default_rng(0), 40
    i, t = np.arcsin(rng.uniform(-1.0, 1.0, n)), rng.uniform(0.0, 2.0 * np.pi, n)
    u = np.stack([np.cos(i) * np.sin(t), np.cos(i) * np.cos(t), np.sin(i)], axis=-1)
    reading = STANDARD_GRAVITY * u + MG * rng.standard_normal((n, 3)) * [1.0, 6.0, 6.0]
    once = np.zeros(n, np.intp)
    data = Observations(
        reading[:, None], np.full((n, 1, 3), MG), KnownVector(i, t, STANDARD_GRAVITY, once, once),
        Context(n), np.arange(n), ("",) * n,
    )  # fmt: skip
    assert axes_of(with_noisy_axes(fit(BASE, data))) == {"noise of y", "noise of z"}


def test_it_is_looked_for_in_forty_rows(tmp_path: Path) -> None:
    for n, due in ((40, {"noise of z"}), (41, set())):
        found = with_noisy_axes(fitted(noisier(tmp_path / "s.csv", 3, (1.0, 1.0, 8.0), n=n)))
        assert axes_of(found) == due


def test_alike_axes_stay_alike(tmp_path: Path) -> None:
    """One of fifty is expected; five of thirty come by chance in 3e-4 of all runs, and at a rate of
    one in four in 0.9."""
    found = [
        with_noisy_axes(fitted(noisier(tmp_path / "s.csv", seed, (1.0, 1.0, 1.0), n=24)))
        for seed in range(30)
    ]
    assert sum(bool(axes_of(one)) for one in found) < 5


def test_a_part_of_the_observations_keeps_its_own_noise(tmp_path: Path) -> None:
    found = with_noisy_axes(fitted(noisier(tmp_path / "s.csv", 4, (1.0, 1.0, 5.0))))
    (noise,) = found.observations.shared
    part = noise.take(np.array([3, 7, 9]))
    np.testing.assert_array_equal(part.factor, np.eye(3))
    assert part.basis is not None
    assert part.alone
    assert not found.observations.of_sessions
    assert found.observations.walk is None


def test_more_noise_is_no_setting_of_a_record(tmp_path: Path) -> None:
    found = with_noisy_axes(fitted(noisier(tmp_path / "s.csv", 4, (1.0, 1.0, 5.0))))
    told = {c.name.partition(":")[2] for c in record_candidates(found)}
    assert told == {"x", "y", "z", "inclination setting", "tool-face setting"}


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_noisy_axis_is_no_claim(tmp_path: Path, seed: int) -> None:
    """Before, records were doubted beside it, and steps of the bias suspected; it is told."""
    path = noisier(tmp_path / "s.csv", seed, (1.0, 1.0, 6.0))
    run = run_lab(read_position_table(path), LabRequest(unit="mg"))
    assert run.result.loop is not None
    assert not run.result.loop.steps
    assert not run.result.loop.records
    assert all(u.name.startswith("z scatters ") for u in run.result.loop.unexplained)
    assert run.calibration.facts["noise"]["reading_each_mg"][2] == pytest.approx(3.0, rel=0.4)


@pytest.mark.parametrize("rows", [40, 60])
@pytest.mark.parametrize(("times", "told"), [(2.0, 0), (8.0, 1)])
def test_an_axis_far_noisier_than_any_chip_s_is_told(
    times: float, told: int, rows: int, tmp_path: Path
) -> None:
    found = with_noisy_axes(fitted(noisier(tmp_path / "s.csv", 4, (1.0, times, 1.0), rows)))
    doubts = doubtful_axes(found, 0.01)
    assert len(doubts) == told
    assert all(d.name.startswith("y scatters by ") for d in doubts)
