"""Noise in the units that the report says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibrators.lab.calibration import noise_block
from imucalib.estimators.least_squares import fit
from imucalib.loop.posterior.noise import shared_bias
from worlds.bench import base_model, bench, draw, ordinary_theta


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
