"""Several logs of one board: agreement, pooling, and what a new log will be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag, null_space
from scipy.optimize import minimize_scalar
from scipy.stats import multivariate_normal

from imucalib.calibrators.array.board.board import read_board
from imucalib.calibrators.array.calibrate import calibrate_array
from imucalib.calibrators.array.logs import BoardRun, PooledLogs, between_logs, board_run, pool_logs
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.calibrators.array.run import ArrayRun
from imucalib.errors import UsageError
from worlds.boards import BoardPlan, board_log, made_board

BOARD = read_board("mimu4444_corners")
PLAN = BoardPlan(twist_s=8.0, gyro_scale=0.004, gyro_bias=1.0)
PARTS = made_board(BOARD.positions, BOARD.rotations, BOARD.imus, PLAN, np.random.default_rng(7))


def log(seed: int, plan: BoardPlan = PLAN) -> ArrayRun:
    made = board_log(PARTS, plan, np.random.default_rng(seed))
    recording = replace(made.recording, path=f"log_{seed}.h5")
    return calibrate_array(recording, ArrayRequest(board=BOARD, loop=False), lambda _: None)


@pytest.fixture(scope="module")
def found() -> BoardRun:
    return board_run(tuple(log(seed) for seed in (1, 2, 3)))


@pytest.mark.slow
def test_logs_of_one_board_agree_and_pool(found: BoardRun) -> None:
    assert found.pooled.freedom == 42
    assert found.pooled.p > 1e-3
    one = np.median(np.sqrt(np.diag(found.runs[0].total.motion)))
    assert np.median(np.sqrt(np.diag(found.pooled.covariance))) < 0.75 * one
    off = found.total.distance(0, 7)[0] - np.linalg.norm(PARTS.positions[7])
    assert abs(off) < 4.0 * found.total.distance(0, 7)[1]
    assert found.outcome.exit_code == 0


@pytest.mark.slow
def test_a_log_of_another_board_is_seen() -> None:
    moved = replace(PARTS, positions=PARTS.positions + np.array([0.0, 0.0, 2e-4]) *
                    (np.arange(8) % 2)[:, None])  # fmt: skip
    made = board_log(moved, PLAN, np.random.default_rng(5))
    other = calibrate_array(made.recording, ArrayRequest(board=BOARD, loop=False), lambda _: None)
    found = board_run((log(1), other))
    assert found.pooled.p < 1e-6
    assert found.pooled.tau > 3e-5
    assert any("differ by more than they state" in text for text in found.outcome.reasons)


def test_one_log_is_no_joint_estimate() -> None:
    with pytest.raises(UsageError, match="two or more logs"):
        board_run(())


def covariances(rng: np.random.Generator, n: int, d: int) -> np.ndarray:
    """(n, d, d) of about unit size, each of its own shape."""
    roots = np.eye(d) + 0.4 * rng.normal(size=(n, d, d)) / np.sqrt(d)
    return roots @ roots.transpose(0, 2, 1)


def logs(seed: int, n: int, tau: float, d: int = 21) -> tuple[PooledLogs, np.ndarray]:
    rng = np.random.default_rng(seed)
    spread = covariances(rng, n, d)
    true = rng.normal(size=d) * 50.0
    noise = np.einsum("nij,nj->ni", np.linalg.cholesky(spread), rng.normal(size=(n, d)))
    return pool_logs(true + noise + tau * rng.normal(size=(n, d)), spread), true


@pytest.mark.parametrize("tau", [0.0, 1.0])
def test_errors_and_predictions_are_what_is_stated(tau: float) -> None:
    errors, left_out, taus, p = [], [], [], []
    for seed in range(40):
        found, true = logs(seed, 5, tau)
        off = found.mean - true
        errors.append(off @ np.linalg.solve(found.covariance, off) / off.size)
        left_out.append(np.mean(found.left_out**2))
        taus.append(found.tau)
        p.append(found.p)
    assert np.sqrt(np.mean(errors)) == pytest.approx(1.0, abs=0.1)
    assert np.sqrt(np.mean(left_out)) == pytest.approx(1.0, abs=0.1)
    if tau:
        assert np.mean(taus) == pytest.approx(tau, rel=0.1)
        assert np.max(p) < 1e-2
    else:
        assert np.median(taus) < 0.3
        # Agreement is a chi-square at its degrees of freedom: p is uniform.
        assert 0.35 < np.mean(p) < 0.65
        assert np.min(p) < 0.15


@pytest.mark.parametrize("tau", [0.2, 3.0])
def test_tau_is_the_maximum_of_the_restricted_likelihood(tau: float) -> None:
    """By its definition: the density of the contrasts that no common mean moves."""
    rng = np.random.default_rng(3)
    n, d = 6, 3
    spread = 0.01 * covariances(rng, n, d)
    values = rng.multivariate_normal(np.zeros(d), 0.01 * np.eye(d), n) + tau * rng.normal(
        size=(n, d)
    )
    contrasts = null_space(np.tile(np.eye(d), n))

    def density(x: float) -> float:
        whole = contrasts.T @ (block_diag(*spread) + np.exp(2 * x) * np.eye(n * d)) @ contrasts
        return float(multivariate_normal(cov=whole).logpdf(contrasts.T @ values.ravel()))

    best = minimize_scalar(lambda x: -density(x), bounds=(-3, 3), method="bounded")
    assert between_logs(values, spread) == pytest.approx(np.exp(best.x), rel=1e-3)
