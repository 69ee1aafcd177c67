"""Misfits of later rests: who changed, one wrong reading, noise that readings share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gates.bounds import at_most
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.checking.check import Check, Measured, check
from imucalib.calibration.checking.misfit import (
    BAD_REST,
    Misfits,
    change_question,
    misfits_of,
    triad_misfits,
)
from imucalib.calibration.checking.noise import check_noise
from imucalib.calibration.triads import Triad
from imucalib.core.effect import Context
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm
from imucalib.posterior.closed_loop.changes import NOISE
from worlds.instrument import DEG, MG, G, four, vectors
from worlds.stated import stated


def looked_at(rests: int, shift: np.ndarray) -> Check:
    """Rests of one IMU, noise 0.25 mg; shift : (rests, 3) mg beside what was calibrated."""
    rng = np.random.default_rng(rests)
    root = np.diag([2e-4] * 9 + [0.2 * MG] * 3)
    triad = Triad("imu0", np.eye(3), np.eye(3), np.zeros(3), np.eye(3), np.zeros(3), root @ root.T,
                  0.03, 0.1 * DEG)  # fmt: skip
    calibration = Calibration(
        "array", (), np.zeros((0, 0)), "m/s2", 1.0, G, "ok",
        facts={"rests": {"count": 24, "residual_m_per_s2": 0.25 * MG}},
        triads=(triad, replace(triad, name="imu1")),
    )  # fmt: skip
    force = rng.normal(size=(rests, 3))
    force *= G / np.linalg.norm(force, axis=1, keepdims=True)
    along = force / G
    reading = force + MG * shift * along + 0.25 * MG * rng.standard_normal(force.shape)
    noise = check_noise(calibration)
    misfits = triad_misfits(calibration, triad, reading, noise, np.zeros(rests))
    return check(calibration, [Measured(misfits, "imu0")], noise, {})


def wrong_in(rests: int, *rows: int) -> np.ndarray:
    """40 mg along gravity in some rows, of either sign by turns."""
    out = np.zeros((rests, 3))
    for k, row in enumerate(rows):
        out[row] = 40.0 * (-1) ** k
    return out


@pytest.mark.parametrize(("rests", "row"), [(16, 3), (16, 15), (8, 5)])
def test_the_one_reading_that_is_off_is_named(rests: int, row: int) -> None:
    found = looked_at(rests, wrong_in(rests, row))
    assert found.verdict == "undecided"  # the sensor may be as it was
    assert (found.sensors[0].causes, found.sensors[0].alone) == ((), row)
    assert found.sensors[0].answer.of(BAD_REST) > 0.95


@pytest.mark.parametrize("rows", [(), (3, 9)], ids=["none", "two"])
def test_no_reading_is_set_apart(rows: tuple[int, ...]) -> None:
    """Where nothing shows, and where one does not explain it."""
    found = looked_at(16, wrong_in(16, *rows))
    assert (found.verdict == "changed") == bool(rows)
    assert found.sensors[0].alone is None
    assert found.sensors[0].answer.told == bool(rows)


def test_noise_that_grew_is_told_as_noise() -> None:
    """Four times the stated 0.25 mg, in 24 rests."""
    rng = np.random.default_rng(5)
    found = looked_at(24, np.repeat(rng.normal(scale=1.0, size=24)[:, None], 3, axis=1))
    assert found.sensors[0].causes == (NOISE,)


def test_a_change_that_explains_all_rows_is_no_wrong_reading() -> None:
    """A scale that is off by 20 mg/g along every axis."""
    found = looked_at(16, np.full((16, 3), 20.0))
    assert "scale" in found.sensors[0].causes
    assert found.sensors[0].alone is None


ROTATION = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def imu(rng: np.random.Generator) -> Triad:
    gain = np.eye(3) + 0.005 * rng.standard_normal((3, 3))
    root = np.diag([2e-4] * 9 + [0.2 * MG] * 3) @ (np.eye(12) + 0.2 * rng.standard_normal((12, 12)))
    return Triad("imu0", ROTATION, gain, 0.1 * rng.standard_normal(3), np.eye(3),
                 0.5 * DEG * rng.standard_normal(3), root @ root.T, 0.03, 0.002)  # fmt: skip


def board(triad: Triad) -> Calibration:
    """Twelve rests of two IMUs that scatter by 0.25 mg."""
    return Calibration(
        "array", (), np.zeros((0, 0)), "m/s2", 1.0, G, "ok",
        facts={"rests": {"count": 12, "residual_m_per_s2": 0.25 * MG}},
        triads=(triad, replace(triad, name="imu1")),
    )  # fmt: skip


def test_the_imu_that_changed_is_named() -> None:
    rng = np.random.default_rng(2)
    triad = imu(rng)
    force = np.concatenate([vectors(*four(rng)) for _ in range(3)])
    clean = (force @ triad.gain.T + triad.bias) @ ROTATION
    calibration = board(triad)
    noise = check_noise(calibration)
    measured = []
    for k, shift in enumerate((0.0, 2.5)):
        reading = clean + 0.25 * MG * rng.standard_normal(clean.shape) + [shift * MG, 0.0, 0.0]
        misfits = triad_misfits(calibration, triad, reading, noise, np.zeros(12))
        measured.append(Measured(misfits, f"imu{k}"))
    found = check(calibration, measured, noise, {})
    assert found.verdict == "changed"
    assert [s.name for s in found.changed] == ["imu1"]
    # A package's +x is the board's -y.
    assert found.sensors[1].sizes["bias"].value == pytest.approx([0.0, -2.5, 0.0], abs=1.0)


MEMORY, ALONE, SHARED = 4.0, 0.2, 0.73


def calibration(alone: float) -> Calibration:
    """Of a sensor without any error, known to next to nothing."""
    noise = {
        "reading_mg": alone, "reading_sd_mg": 0.05 * alone, "shared_mg": SHARED,
        "shared_sd_mg": 0.2 * SHARED, "shared_memory_positions": MEMORY,
    }  # fmt: skip
    nine = {name: np.zeros(3) for name in ("bias", "scale", "non_orthogonality")}
    return stated(nine, 1e-12 * np.eye(9), facts={"noise": noise})


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
        white.append(np.linalg.solve(np.linalg.cholesky(found.covariance), found.value))
    values = np.array(white)
    assert np.mean(values**2) == pytest.approx(1.0, abs=0.13)
    assert np.mean(values[:, 1:] * values[:, :-1]) == pytest.approx(0.0, abs=0.1)


@pytest.mark.slow
def test_an_unchanged_sensor_that_shares_all_its_noise_is_not_changed() -> None:
    """With the reading's own noise at its bound every later reading was a change."""
    matters = {"bias": 2.0, "scale": 2.0}
    told = [change_question(misfits(6, seed, 0.0), matters).answer().told for seed in range(60)]
    assert sum(told) <= at_most(60, 0.05).most
