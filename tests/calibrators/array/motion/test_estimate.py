"""What an array's estimate states: errors, what is left, drives, size and frame."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.calibrators.array.board.turns import BoardTurns, GyroScale, common_scale
from imucalib.calibrators.array.findings import Residual, find_unexplained
from imucalib.calibrators.array.motion.covariance import (
    Uneven,
    sandwich,
    uneven,
)
from imucalib.calibrators.array.motion.total import Distance, Total, total_of
from imucalib.calibrators.array.request import Accepted
from worlds.array import corners
from worlds.boards import DEG, Array, BoardPlan, handled
from worlds.twisted_board import BOARD, fitted


def test_a_tight_wrong_drawing_gives_way_to_the_motion() -> None:
    # Places .2 mm off, which the board file allows 3 mm, or .01.
    plan = BoardPlan(twist_s=10.0, places=2e-4)
    free, true = fitted(plan, 1, 450)
    tight, _ = fitted(plan, 1, 450, replace(BOARD, prior_sd=1e-5))
    assert free.converged
    assert tight.converged
    sd = np.sqrt(np.diag(free.covariance))[: free.positions].reshape(-1, 3)
    assert np.all(np.abs(tight.r - free.r)[1:] < 0.5 * sd)
    assert np.all(np.abs(tight.r - true)[1:] < 5.0 * sd)


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
    left = find_unexplained(residual, rests, BOARD.imus, Accepted(), None)  # type: ignore[arg-type]
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


PLAN = BoardPlan(rests=16)


def turns_of(scale: float, seed: int) -> BoardTurns | None:
    """Gyros that read (1 + scale) ω with an offset that wanders, and gravity a little off."""
    rng = np.random.default_rng(seed)
    w, _, force = handled(PLAN, rng)
    t = np.arange(len(w)) / PLAN.hz
    drift = (0.02 + 0.01 * t[:, None] / t[-1]) * np.array([1.0, -1.0, 0.5])
    rate = (1.0 + scale) * w + drift + rng.normal(size=w.shape) * 0.1 * DEG
    start = np.arange(PLAN.rests) * (PLAN.rest_s + PLAN.turn_s)
    stop = start + PLAN.rest_s - 1.0 / PLAN.hz
    at = np.round((start + 1.0) * PLAN.hz).astype(int)
    up = force[at] / np.linalg.norm(force[at], axis=1, keepdims=True)
    up += rng.normal(size=up.shape) * 2e-3
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    return common_scale(t, rate, np.ones(len(t), dtype=np.bool_), up, start, stop)


@pytest.mark.slow
def test_turns_between_rests_show_the_common_scale() -> None:
    z = []
    for seed in range(30):
        scale = 0.005 * np.random.default_rng(100 + seed).normal()
        found = turns_of(scale, seed)
        assert found is not None
        assert found.sd < 2e-3
        z.append((found.scale - scale) / found.sd)
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.35


def total(*distances: Distance, scale: float = 0.002) -> Total:
    r = corners(5)
    root = np.random.default_rng(1).normal(size=(12, 12)) * 1e-5
    return total_of(
        r, root @ root.T, gyros=GyroScale(scale, 1e-3, 1e-3, None), gravity_sd=5e-4, frame_sd=2e-3,
        distances=distances,
    )  # fmt: skip


def test_the_total_is_what_draws_scatter() -> None:
    found, rng = total(), np.random.default_rng(2)
    n = 40_000
    moved = rng.multivariate_normal(np.zeros(12), found.motion, n).reshape(n, 4, 3)
    r = found.by_motion[1:] + moved
    size = (1.0 + 0.002 + 1e-3 * rng.normal(size=n)) ** 2 * (1.0 + 5e-4 * rng.normal(size=n))
    turn = 2e-3 * rng.normal(size=(n, 1, 3))
    drawn = (size[:, None, None] * (r + np.cross(turn, r))).reshape(n, 12)
    assert found.mean[1:].ravel() == pytest.approx(drawn.mean(axis=0), abs=1e-6)
    white = np.linalg.solve(np.linalg.cholesky(found.covariance), (drawn - drawn.mean(axis=0)).T)
    assert np.cov(white) == pytest.approx(np.eye(12), abs=0.04)
    value, sd = found.distance(1, 3)
    apart = np.linalg.norm(drawn[:, 6:9] - drawn[:, 0:3], axis=1)
    assert (value, sd) == pytest.approx((apart.mean(), apart.std()), rel=0.02)
    # The shape has neither size nor turn in it.
    rank = np.linalg.matrix_rank(found.shape, tol=1e-9 * np.linalg.norm(found.shape))
    assert rank == 12 - 4


def test_a_distance_fixes_the_size_and_nothing_else() -> None:
    plain = total()
    value, sd = plain.distance(0, 4)
    found = total(Distance(0, 4, value * 1.001, 1e-7))
    assert found.distance(0, 4) == pytest.approx((value * 1.001, 1e-7), rel=0.05)
    assert found.distance(0, 4)[0] == pytest.approx(value * 1.001, rel=1e-6)
    assert found.distance(0, 3)[1] < plain.distance(0, 3)[1]
    assert found.size_sd < 0.9 * plain.size_sd
    assert found.frame_sd == pytest.approx(plain.frame_sd)
    vague = total(Distance(0, 4, value * 1.1, 1.0))
    assert vague.mean == pytest.approx(plain.mean, abs=1e-9)
    assert vague.distance(0, 4)[1] == pytest.approx(sd, rel=1e-3)
