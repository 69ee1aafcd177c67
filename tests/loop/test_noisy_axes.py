"""An axis that is noisier than the others is noise: no wrong record, no heavy tail, no effect."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imucalib.calibrators.lab.position_table import read_position_table
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import run_lab
from worlds.plain_bench import Bench, Plan


def noisier(path: Path, seed: int, times: tuple[float, float, float], n: int = 40) -> Path:
    """A sheet whose axes have so many times 0.5 mg of noise."""
    bench = Bench(Plan(seed, sigma=1e-6, n=n))
    rng = np.random.default_rng((seed, 9))
    bench.reading = bench.reading + 0.5 * np.array(times) * rng.standard_normal((n, 3))
    return bench.write(path)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_noisy_axis_is_no_claim(tmp_path: Path, seed: int) -> None:
    """Before, records were doubted beside it, and steps of the bias suspected."""
    path = noisier(tmp_path / "s.csv", seed, (1.0, 1.0, 6.0))
    run = run_lab(read_position_table(path), LabRequest(unit="mg"))
    assert run.result.loop is not None
    assert not run.result.loop.steps
    assert not run.result.loop.records
