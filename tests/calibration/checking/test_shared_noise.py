"""Noise that neighbouring readings share belongs to a later recording too."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.calibration.calibration import Calibration, StoredParameter
from imucalib.calibration.checking.misfit import Misfits, check_noise
from imucalib.calibration.checking.next_rests import misfits_of
from imucalib.calibration.checking.statistic import Statistic
from imucalib.core.effect import Context
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm
from worlds.instrument import MG, G

MEMORY, ALONE, SHARED = 4.0, 0.2, 0.73
NINE = (*(f"bias_{a}" for a in "xyz"), *(f"scale_{a}" for a in "xyz"), "cross_yx", "cross_zx",
        "cross_zy")  # fmt: skip


def calibration(alone: float) -> Calibration:
    """Of a sensor without any error, known to next to nothing."""
    effects = ["bias"] * 3 + ["scale"] * 3 + ["non_orthogonality"] * 3
    units = ["mg"] * 3 + ["1"] * 6
    stored = tuple(
        StoredParameter(n, e, "sensor", 0.0, 1e-6, u)
        for n, e, u in zip(NINE, effects, units, strict=True)
    )
    noise = {
        "reading_mg": alone, "reading_sd_mg": 0.05 * alone, "shared_mg": SHARED,
        "shared_sd_mg": 0.2 * SHARED, "shared_memory_positions": MEMORY,
    }  # fmt: skip
    return Calibration("lab", stored, 1e-12 * np.eye(9), "m/s2", 1.0, G, "ok",
                       facts={"noise": noise})  # fmt: skip


def read(rests: int, rng: np.random.Generator, alone: float) -> Observations:
    """Rests in random attitudes, in turn, with a bias that wanders from one to the next."""
    force = rng.normal(size=(rests, 3))
    force *= G / np.linalg.norm(force, axis=1, keepdims=True)
    apart = np.abs(np.subtract.outer(np.arange(rests), np.arange(rests)))
    root = np.linalg.cholesky(np.exp(-apart / MEMORY))
    bias = SHARED * root @ rng.standard_normal((rests, 3))
    reading = force + MG * (bias + alone * rng.standard_normal((rests, 3)))
    label = tuple(f"row {k + 1}" for k in range(rests))
    return Observations(reading[:, None], np.ones((rests, 1, 3)), KnownNorm(rests, G),
                        Context(rests), np.arange(rests), label)  # fmt: skip


def misfits(rests: int, seed: int, alone: float) -> Misfits:
    own, rng = calibration(alone), np.random.default_rng(seed)
    return misfits_of(own, read(rests, rng, alone), check_noise(own))[0]


@pytest.mark.slow
@pytest.mark.parametrize("alone", [ALONE, 0.0])
def test_misfits_scatter_and_hang_together_as_stated(alone: float) -> None:
    """Whitened by the stated covariance, 400 recordings of six rests are 2400 standard normal
    numbers: mean square 1 ± 0.03, products of neighbours 0 ± 0.022."""
    white = []
    for seed in range(400):
        found = misfits(6, seed, alone)
        white.append(found.white(found.value))
    values = np.array(white)
    assert np.mean(values**2) == pytest.approx(1.0, abs=0.13)
    assert np.mean(values[:, 1:] * values[:, :-1]) == pytest.approx(0.0, abs=0.1)


def test_a_reading_scatters_by_both_with_the_freedom_of_both() -> None:
    noise = check_noise(calibration(ALONE))
    assert noise.reading.sd / MG == pytest.approx(np.hypot(ALONE, SHARED))
    squares = np.array([ALONE, SHARED]) ** 2
    freedom = squares.sum() ** 2 / np.sum(squares**2 / np.array([200.0, 12.5]))
    assert noise.reading.dof == pytest.approx(freedom)
    assert "of which neighbours share 93 %" in noise.words[0]


@pytest.mark.slow
def test_an_unchanged_sensor_that_shares_all_its_noise_is_not_changed() -> None:
    """With the reading's own noise at its bound every later reading was a change. 60 checks at
    5 %: more than nine have a chance of 1 in 1000."""
    changed = 0
    for seed in range(60):
        changed += Statistic(misfits(6, seed, 0.0), seed, draws=999).p() <= 0.05
    assert changed <= 9
