"""Size and frame: the turns between rests against the truth, the total against draws."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.calibrators.array.estimate.total import (
    Distance,
    GyroScale,
    Total,
    total_of,
)
from imucalib.calibrators.array.estimate.turns import Turns, common_scale
from worlds.array import corners
from worlds.boards import DEG, BoardPlan, handled

PLAN = BoardPlan(rests=16)


def turns_of(scale: float, seed: int) -> Turns | None:
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
