"""The array's rests through the shared core: gains, warm-up, a bad rest."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.calibrators.array.board.board import Board
from imucalib.calibrators.array.board.rests import RestFit, fit_rests
from imucalib.calibrators.request import Request
from imucalib.errors import Undetermined
from imucalib.rests.segments import Segments
from imucalib.units import DEG, MG

G = 9.8
K = 5
SIGMA = 2e-3


def _turns(n: int, rng: np.random.Generator) -> Array:
    q = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]
    return q * np.sign(np.linalg.det(q))[:, None, None]


def _board(rng: np.random.Generator) -> Board:
    positions = rng.normal(size=(K, 3)) * 0.02
    return Board("test", tuple(f"imu{k}" for k in range(K)), positions, _turns(K, rng))


def simulated(
    seed: int, n: int = 20, warm: float = 0.0, faces: int = 0
) -> tuple[Segments, Board, Array, Array]:
    """Rests of K triads, the first of them on faces; gains (K, 3, 3) and offsets (K, 3) in their
    own axes, the gains' mean rotation in board axes taken out. warm : m/s², exponential warm-up of
    each axis, either sign."""
    rng = np.random.default_rng(seed)
    board = _board(rng)
    turn = board.rotations
    gain = np.eye(3) + 0.01 * rng.normal(size=(K, 3, 3))
    skew = np.mean(turn @ gain @ turn.transpose(0, 2, 1), axis=0)
    skew = 0.5 * (skew - skew.T)
    gain = gain - turn.transpose(0, 2, 1) @ skew @ turn
    offset = 0.3 * rng.normal(size=(K, 3))
    u = rng.normal(size=(n, 3))
    u[:faces] = np.vstack([np.eye(3), -np.eye(3)])[:faces]
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    start = 30.0 * np.arange(n)
    order = np.linspace(0.0, 1.0, n)
    size = warm * rng.choice([-1.0, 1.0], (K, 3))
    force = G * np.einsum("kji,nj->nki", turn, u)
    mean = np.einsum("kij,nkj->nki", gain, force) + offset
    mean = mean + size * np.exp(-4.0 * order)[:, None, None]
    mean = mean + SIGMA * rng.normal(size=mean.shape)
    rate = 1e-3 * rng.normal(size=(1, K, 3)) + 1e-5 * rng.normal(size=mean.shape)
    ones = np.ones((K, 3))
    count = np.full((n, K), 100, dtype=np.intp)
    segments = Segments(
        start=start,
        stop=start + 20.0,
        triads=board.imus,
        spans=(),
        samples=count,
        mean=mean,
        rate=rate,
        temperature=np.full((n, K), np.nan),
        noise=0.02 * ones,
        rate_noise=1e-3 * ones,
        step=0.0 * ones,
        rate_step=0.0 * ones,
    )
    return segments, board, gain, offset


def fitted(segments: Segments, board: Board, **asked: Any) -> RestFit:
    return fit_rests(segments, board, Request(gravity=G, **asked))


@pytest.mark.slow
def test_gains_and_offsets_within_their_deviation() -> None:
    z = []
    for seed in range(8):
        segments, board, gain, offset = simulated(seed)
        found = fitted(segments, board, loop=False)
        sd = np.sqrt(np.diag(found.covariance.reshape(12 * K, 12 * K))).reshape(K, 12)
        z.append((found.gain - gain).reshape(K, 9) / sd[:, :9])
        z.append((found.offset(np.array([found.stop]))[0] - offset) / sd[:, 9:])
    size = np.sqrt(np.mean(np.concatenate([part.ravel() for part in z]) ** 2))
    assert 0.93 < size < 1.07  # 480 numbers: sd of the rms is 0.032


def test_the_file_has_the_mean_of_a_drift_and_the_drift_as_its_doubt() -> None:
    warm = 0.03
    segments, board, _, offset = simulated(3, warm=warm)
    found = fitted(segments, board)
    course = warm * np.exp(-4.0 * np.linspace(0.0, 1.0, segments.n))
    _, bias, covariance = found.in_board_axes()
    own = np.einsum("kji,kj->ki", board.rotations, bias) - offset
    # Either sign of the drift; its mean and its scatter over the rests are those of every axis.
    assert np.all(np.abs(np.abs(own) - course.mean()) < 5.0 * SIGMA)
    sd = np.sqrt(np.trace(covariance[:, 9:, 9:], axis1=1, axis2=2) / 3.0)
    np.testing.assert_allclose(sd, course.std(), rtol=0.15)
    away = found.away(segments.middle)
    np.testing.assert_allclose(away.mean(axis=0), 0.0, atol=1e-12)
    assert float(np.sqrt(np.mean(away**2))) == pytest.approx(course.std(), rel=0.1)


@pytest.mark.slow
def test_a_gain_that_drifts_is_undone_at_every_time() -> None:
    """An array whose rests showed it ended with a traceback."""
    segments, board, _, offset = simulated(6, n=40)
    late = np.linspace(0.0, 1.0, 40)
    drift = 0.01 * np.linspace(-1.0, 1.0, K)
    drifted = (segments.mean - offset) * (1.0 + late[:, None] * drift)[..., None] + offset
    found = fitted(replace(segments, mean=drifted), board)
    assert found.loop is not None
    assert [s.effect for s in found.loop.steps] == ["scale_drift"]
    seen = np.einsum("kij,nkj->nki", board.rotations, drifted)
    force = found.correct(seen, 0.5 * (segments.start + segments.stop))
    assert np.linalg.norm(force, axis=2) == pytest.approx(np.full((40, K), G), rel=1e-3)


def test_a_rest_that_was_none_is_a_wrong_record() -> None:
    segments, board, _, _ = simulated(13)
    segments.mean[5] *= 1.01  # the board fell a little
    found = fitted(segments, board)
    assert found.loop is not None
    assert [(r.row, r.channel) for r in found.loop.records] == [(5, "all")]
    assert found.loop.records[0].size == pytest.approx(10.0, rel=0.1)


@pytest.mark.parametrize("n", [9, 10, 11])
def test_few_rests_hold_out_what_they_can(n: int) -> None:
    """Nine rests are as many as a triad of unknown attitude has parameters: without one of them
    nothing foretells it, so what is seen beside is told, and corrected only where it is proved."""
    segments, board, _, _ = simulated(15, n, faces=6)
    for k, mean in enumerate(segments.mean.transpose(1, 0, 2)):
        mean[:] += (0.0004 + 0.0001 * k) * mean**2
    found = fitted(segments, board)
    assert found.loop is not None
    told = {step.effect for step in found.loop.steps} | {u.name for u in found.loop.unexplained}
    assert "quadratic" in told
    assert bool(found.loop.steps) == (n > 9)
    if n == 9:
        assert "determine the sensor no more" in dict(found.loop.rejected)["quadratic"]


def test_rests_that_determine_nothing_are_not_searched() -> None:
    segments, board, _, _ = simulated(14, 9)
    for mean in segments.mean.transpose(1, 0, 2):
        mean[:] += 0.002 * mean**2
    with pytest.raises(Undetermined, match="too alike"):
        fitted(segments, board)


@pytest.mark.slow
def test_clean_rests_are_left_alone() -> None:
    claimed = 0
    for seed in range(30, 50):
        segments, board, _, _ = simulated(seed)
        loop = fitted(segments, board).loop
        assert loop is not None
        claimed += bool(loop.steps or loop.records)
    # At a true rate of 4.5 % four of twenty come once in 90 runs.
    assert claimed <= 3


def _uneven(seed: int, between: float) -> tuple[Segments, Board, Array, Array]:
    """Every fourth rest is 25 times shorter than the others; `between` in m/s²."""
    rng = np.random.default_rng(1000 + seed)
    segments, board, gain, offset = simulated(seed)
    short = np.arange(segments.n) % 4 == 3
    samples = np.where(short[:, None], 100, 2500) * np.ones((1, K), dtype=np.intp)
    segments.mean[:] += np.where(short, 4.9 * SIGMA, 0.0)[:, None, None] * rng.normal(
        size=segments.mean.shape
    )  # 5 times SIGMA in all
    segments.mean[:] += between * rng.normal(size=segments.mean.shape)
    noise = np.full((K, 3), SIGMA * 50.0)
    return replace(segments, samples=samples, noise=noise), board, gain, offset


@pytest.mark.parametrize("between", [0.0, 1.0, 4.0, 20.0])
def test_what_differs_from_rest_to_rest_is_estimated(between: float) -> None:
    segments, board, _, _ = _uneven(5, between=between * SIGMA)
    fit = fitted(segments, board, loop=False).fit
    sigma = fit.noise.factor * fit.observations.sigma[:, 0, 0]
    expected = SIGMA * np.hypot(np.where(np.arange(20) % 4 == 3, 5.0, 1.0), between)
    assert np.abs(np.log(sigma / expected)).max() < 0.25  # the tried sizes are a factor 2 apart


def coarse(segments: Segments, step: float, rate_step: float, bias: Array) -> Segments:
    """The same as a chip imu3 would have it that rounds far above its noise; bias : (3,) rad/s of
    its gyro beside what it has"""
    mean, rate, noise, rate_noise = (
        x.copy() for x in (segments.mean, segments.rate, segments.noise, segments.rate_noise)
    )
    steps, rate_steps = np.zeros((K, 3)), np.zeros((K, 3))
    steps[3], rate_steps[3] = step, rate_step
    mean[:, 3] = np.round(mean[:, 3] / step) * step
    rate[:, 3] += bias
    rate[:, 3] = np.round(rate[:, 3] / rate_step) * rate_step
    noise[3], rate_noise[3] = step / 12**0.5, rate_step / 12**0.5
    return replace(
        segments, mean=mean, rate=rate, noise=noise, rate_noise=rate_noise, step=steps,
        rate_step=rate_steps,
    )  # fmt: skip


@pytest.mark.slow
def test_what_rounding_leaves_is_stated() -> None:
    """16 mg and 1 deg/s: samples by the hundred do not average them."""
    z, slow = [], []
    for seed in range(12):
        segments, board, gain, offset = simulated(seed)
        bias = np.random.default_rng(seed).uniform(-DEG, DEG, 3)
        made = coarse(segments, 16.0 * MG, DEG, bias)
        found = fitted(made, board, loop=False)
        sd = np.sqrt(np.diag(found.covariance.reshape(12 * K, 12 * K))).reshape(K, 12)
        z.append((found.gain - gain).reshape(K, 9) / sd[:, :9])
        z.append((found.offset(np.array([found.stop]))[0] - offset) / sd[:, 9:])
        true = board.rotations[3] @ (bias + segments.rate[:, 3].mean(axis=0))
        slow.append((found.gyro_bias[0, 3] - true) / found.gyro_bias_sd[3])
    for size in (np.concatenate([part.ravel() for part in z]), np.concatenate([p[3] for p in z])):
        assert 0.85 < np.sqrt(np.mean(size**2)) < 1.15  # 720 numbers, and 144 of the coarse one
    assert 0.75 < np.sqrt(np.mean(np.square(slow))) < 1.25  # 36 numbers
