"""Noise in the units that the report says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imucalib.calibrators.lab.calibration import noise_block
from imucalib.calibrators.lab.position_table import read_position_table
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import run_lab
from imucalib.estimators.least_squares import fit
from imucalib.loop.posterior.noise import shared_bias
from worlds.bench import base_model, bench, draw, ordinary_theta
from worlds.plain_bench import Bench, Plan


def test_noise_that_rows_share_is_in_mg() -> None:
    """An AR(1) noise of 30 mm/s² beside 0.3 mg: 3.06 mg, within its own standard deviation."""
    base, data = base_model(), bench(5, 60)
    rng, walk = np.random.default_rng(3), np.zeros((60, 3))
    for k in range(1, 60):
        walk[k] = 0.6 * walk[k - 1] + 0.024 * rng.standard_normal(3)
    made = draw(base, ordinary_theta(base, data, 5), data, 6)
    memory = -1.0 / np.log(0.6)
    shared = (shared_bias(data, memory),)
    found = fit(base, replace(made.with_reading(made.reading + walk[:, None]), shared=shared))
    block = noise_block(found)
    assert block["shared_mg"] == pytest.approx(30.0 / 9.80665, abs=4.0 * block["shared_sd_mg"])
    assert 0.05 < block["shared_sd_mg"] < 1.0
    assert block["shared_memory_positions"] == pytest.approx(memory)


@pytest.mark.slow
def test_a_bias_is_stated_as_well_as_noise_that_rows_share_leaves_it(tmp_path: Path) -> None:
    """Of forty rows whose noise neighbours share, an error of the mean is several times that of as
    many readings: nine sheets of three biases each."""
    away = []
    for seed in range(9):
        bench, rng = Bench(Plan(seed, sigma=0.5, n=40)), np.random.default_rng((seed, 5))
        walk = rng.standard_normal((40, 3))
        for k in range(1, 40):
            walk[k] = 0.8 * walk[k - 1] + 0.6 * walk[k]
        bench.reading = bench.reading + 1.5 * walk
        table = read_position_table(bench.write(tmp_path / "sheet.csv"))
        found = run_lab(table, LabRequest(unit="mg")).result.final
        part = found.model.slices(found.observations.context)["bias"]
        away += list((found.theta[part] - bench.bias) / found.sd[part])
    assert np.sum(np.abs(away) > 1.96) <= 3
    assert 0.5 < np.sqrt(np.mean(np.square(away))) < 1.5
