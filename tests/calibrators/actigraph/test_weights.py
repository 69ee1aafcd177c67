"""What a posture run counts: its own noise, and what runs differ by beside it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.calibrators.actigraph.observations import weighted
from imucalib.core.effect import Context
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm
from imucalib.units import MG

N = 600


def world(between: float, seed: int) -> tuple[SimpleNamespace, SimpleNamespace, np.ndarray]:
    """Runs of 1 to 40 windows whose |a| is off by `between` (m/s²) and their noise, ten of them by
    thirty times that; the sd of each."""
    rng = np.random.default_rng(seed)
    windows = rng.integers(1, 41, N)
    runs = SimpleNamespace(n=N, windows=windows, window_noise=4.0 * MG * np.ones(N),
                           noise=np.full(3, 5.0 * MG), resolution=np.full(3, MG))  # fmt: skip
    sd = np.hypot(between, 4.0 * MG / np.sqrt(windows))
    misfit = sd * rng.standard_normal(N)
    misfit[:10] = 30.0 * sd[:10]
    data = Observations(np.zeros((N, 1, 3)), np.ones((N, 1, 3)), KnownNorm(N, 9.8), Context(N),
                        np.arange(N), tuple(map(str, range(N))))  # fmt: skip
    declared = rng.uniform(0.5, 2.0, N)
    at = SimpleNamespace(residual=misfit / declared, sigma=declared[:, None] * np.ones((N, 3)))
    return SimpleNamespace(at=at, observations=data), runs, sd


@pytest.mark.parametrize("mg", [0.3, 1.0, 3.0, 30.0])
def test_what_runs_differ_by_is_told_from_their_noise(mg: float) -> None:
    """The scatter of the size of 600 numbers' median square is 4 %."""
    fit, runs, sd = world(mg * MG, round(10 * mg))
    found, heavy = weighted(fit, runs)  # type: ignore[arg-type]
    usual = found.sigma[10:, 0, 0] / sd[10:]
    assert np.median(usual) == pytest.approx(1.0, abs=0.12)
    assert 10 <= heavy <= 12


def test_a_run_beyond_four_deviations_counts_as_one_at_four() -> None:
    fit, runs, sd = world(3.0 * MG, 5)
    found, _ = weighted(fit, runs)  # type: ignore[arg-type]
    off = 30.0 * sd[:10] / found.sigma[:10, 0, 0]
    np.testing.assert_allclose(off, 4.0, rtol=1e-3)
