"""What an array's estimate states: errors, what is left, places that follow a drive."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.calibrators.array.estimate.covariance import (
    Uneven,
    sandwich,
    uneven,
)
from imucalib.calibrators.array.findings import Residual, unexplained
from imucalib.calibrators.array.request import Accepted
from imucalib.units import DEG
from worlds.boards import Array, BoardPlan
from worlds.twisted_board import BOARD, fitted


@pytest.mark.slow
@pytest.mark.parametrize("tails", [3.0, np.inf])
def test_errors_are_what_is_stated_with_tails_and_without(tails: float) -> None:
    plan = BoardPlan(twist_s=6.0, tails=tails)
    stated, weights = [], []
    for seed in range(12):
        state, true = fitted(plan, seed, 450)
        off = (state.r - true)[1:].ravel()
        for found, covariance in ((stated, sandwich(state)[0]), (weights, state.covariance)):
            found.append(off @ np.linalg.solve(covariance, off) / off.size)
    z, plain = np.sqrt(np.mean(stated)), np.sqrt(np.mean(weights))
    # 12 sets of 21 numbers: a standard deviation of 0.045.
    assert 0.87 < z < 1.2
    if np.isfinite(tails):
        assert plain > 1.08 * z  # the weights alone say too little
    else:
        assert plain == pytest.approx(z, rel=0.1)


@pytest.mark.parametrize(
    ("noisy", "at_rest", "told"),
    [(1.2, 0.04, ["accelerometer of imu2 in motion"]),
     (1.2, 1.2, ["accelerometer of imu2 in motion"]),
     (0.3, 0.04, [])],
)  # fmt: skip
def test_one_imu_of_eight_that_leaves_more_than_is_accepted_is_told(
    noisy: float, at_rest: float, told: list[str]
) -> None:
    """m/s². No median over all shows it; 0.3 m/s² are within the 50 mg that are accepted."""
    off, still = np.full(8, 0.04), np.full(8, 0.04)
    off[2], still[2] = noisy, at_rest
    gyro = np.full(8, 0.2 * DEG)
    residual = Residual(0.04, 0.2 * DEG, True, (off, gyro))
    rests = SimpleNamespace(noise=still, gyro_noise=gyro)
    left = unexplained(residual, rests, BOARD.imus, Accepted(), None)  # type: ignore[arg-type]
    assert [one.name for one in left if one.beyond] == told
    assert [one.name for one in left[2:]] == told
    if told:
        assert left[2].value == pytest.approx(1e3 * 1.2 / 9.80665, rel=1e-2)


N, BLOCKS, D = 2400, 12, 6


def asked(
    pulls: Array, rate: Array | None = None, force: Array | None = None, factor: float = 1.0
) -> Uneven | None:
    """Of N samples in BLOCKS parts of time."""
    rng = np.random.default_rng(9)
    one = rng.normal(size=(N, 3)) if rate is None else rate
    two = rng.normal(size=(N, 3)) if force is None else force
    state = SimpleNamespace(
        setup=SimpleNamespace(inner=np.arange(N), block=np.arange(N) * BLOCKS // N),
        sampled=SimpleNamespace(rate=one, origin=two),
    )
    return uneven(state, pulls, factor)  # type: ignore[arg-type]


def pulled(seed: int, places: Array, sigma: float = 1.0) -> Array:
    """(N, D) pulls of samples that see places (N, D) about their mean, with noise sigma each."""
    rng = np.random.default_rng(seed)
    return (places - places.mean(axis=0) + sigma * rng.standard_t(5.0, (N, D))) / N


@pytest.mark.parametrize("drive", ["time", "|ω|", "|a|"])
def test_places_that_follow_a_drive_are_told_with_their_spread(drive: str) -> None:
    vector = np.random.default_rng(3).normal(size=(N, 3))
    size = np.linalg.norm(vector, axis=1)
    driver = np.linspace(-1.0, 1.0, N) if drive == "time" else np.argsort(np.argsort(size)) / N
    places = np.zeros((N, D))
    places[:, 2] = 0.5 * driver / np.std(driver)
    kind = {"|ω|": {"rate": vector}, "|a|": {"force": vector}}.get(drive, {})
    found = asked(pulled(1, places, 0.3), **kind)
    assert found is not None
    assert found.follows == drive
    assert found.p < 1e-3
    # Four parts of an even drive hold 0.97 of its sd, twelve nearly all.
    assert 0.9 < found.spread[2] / 0.5 < 1.05
    assert np.delete(found.spread, 2).max() < 0.05
