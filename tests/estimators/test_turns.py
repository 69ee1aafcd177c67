"""The joint fit of rests and turns, on motions and sensors that it did not make."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucalib.estimators.carried import attitudes
from imucalib.estimators.turn_log import Turn, TurnLog
from imucalib.estimators.turns import LOWER, Laws, TurnFit, carry_error, fit_turns, leave_out
from worlds.turned_imu import Chip, chip, turned


def coning(rate: float, seconds: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    """A body that cones by 0.2 rad at 1.5 Hz while it turns, and its rates, both in closed form."""
    t = np.arange(0.0, seconds, 1.0 / rate)
    phase, tilt = 2.0 * np.pi * 1.5 * t, 0.2
    swing = Rotation.from_rotvec(
        tilt * np.column_stack([np.cos(phase), np.sin(phase), np.zeros_like(t)])
    )
    turn = Rotation.from_rotvec(np.outer(5.0 * t, [0.0, 0.0, 1.0]))
    whole = swing * turn
    return t, np.asarray((whole[0].inv() * whole).as_matrix())


@pytest.mark.slow
@pytest.mark.parametrize("rate", [100.0, 400.0])
def test_a_coning_body_is_followed(rate: float) -> None:
    t, true = coning(rate)
    fine, every = coning(2e5)
    step = Rotation.from_matrix(every[:-1]).inv() * Rotation.from_matrix(every[1:])
    omega = step.as_rotvec() / np.diff(fine)[:, None]
    middle = 0.5 * (fine[1:] + fine[:-1])
    seen = np.stack([np.interp(t, middle, v) for v in omega.T], axis=1)
    seen[0] = 2.0 * omega[0] - omega[1]
    off = Rotation.from_matrix(attitudes(t, seen)[-1].T @ true[-1]).magnitude()
    assert np.degrees(off) < 20.0 * (1.0 / rate) ** 2


def known(seed: int, rests: int = 16, **planted: object) -> tuple[Chip, TurnLog]:
    """A log whose rests are where the hand has put them down, 0.8 of the least length inside."""
    rng = np.random.default_rng(seed)
    made = chip(rng, **planted)
    log = turned(made, rng, rests=rests)
    quiet = np.linalg.norm(np.gradient(log.up, log.t, axis=0), axis=1) < 1e-3
    edges = np.flatnonzero(np.diff(np.r_[0, quiet.astype(int), 0]))
    spans = [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a > 100]
    sizes = np.array([b - a for a, b in spans])
    force, rate = (np.array([v[a:b].mean(0) for a, b in spans]) for v in (log.force, log.rate))
    middles = [(a + b) // 2 for a, b in spans]
    turns = []
    for k, (a, b) in enumerate(pairwise(middles)):
        s = slice(a, b + 1)
        turns.append(Turn(k, log.t[s], log.rate[s], log.force[s], np.ones(b + 1 - a)))
    sd = 1.0 / np.sqrt(sizes)
    return made, TurnLog(
        time=log.t[middles], force=force, rate=rate, force_sd=3e-3 * sd,
        rate_sd=np.outer(1e-3 * sd, np.ones(3)), session=np.zeros(len(spans), np.intp),
        turns=tuple(turns), white=1e-4,
    )  # fmt: skip


def far(fit: TurnFit, made: Chip) -> np.ndarray:
    """(18,) standard deviations by which accelerometer and gains are off."""
    lower, state = np.linalg.inv(made.S), fit.state
    own = np.r_[state.bias, [state.lower[i, j] for i, j in LOWER], state.gain.ravel()]
    true = np.r_[made.force_bias, [lower[i, j] for i, j in LOWER], np.linalg.inv(made.M).ravel()]
    return (own - true) / np.sqrt(np.diag(fit.covariance))[:18]


@pytest.mark.slow
def test_gains_are_found_within_their_intervals() -> None:
    z = []
    for seed in range(8):
        made, log = known(seed)
        fit = fit_turns(log)
        assert fit.converged
        assert np.sqrt(np.diag(fit.gains)).max() < 2e-3
        z.append(far(fit, made))
    assert np.mean(np.abs(z) < 1.96) > 0.9
    assert np.abs(z).max() < 4.5


def by_force(rate: np.ndarray, force: np.ndarray, t: np.ndarray) -> np.ndarray:
    out = np.zeros((len(rate), 3, 9))
    for i in range(3):
        out[:, i, 3 * i : 3 * i + 3] = force
    return out


@pytest.mark.slow
def test_sensitivity_to_force_is_a_law_of_nine_numbers() -> None:
    planted = np.radians(0.2) * np.random.default_rng(5).normal(size=(3, 3))
    made, log = known(3, by_force=planted)
    plain, fit = fit_turns(log), fit_turns(log, Laws(by_force), sizes=np.full(9, np.radians(1.0)))
    # Bias and g-sensitivity together: what is known is the fit's own frame of forces.
    sd = np.sqrt(np.diag(fit.gains))[9:]
    assert np.abs((fit.state.theta - planted.ravel()) / sd).max() < 4.0
    every = np.arange(len(log.turns))
    assert np.mean(carry_error(fit, every)) < 0.5 * np.mean(carry_error(plain, every))
    assert np.abs(far(fit, made)).max() < 4.5


def test_a_fold_is_a_refit() -> None:
    _, log = known(4)
    whole = fit_turns(log)
    out = np.arange(len(log.turns)) < 4
    linear, refit = leave_out(whole, out), fit_turns(log, used=~out, start=whole.state)
    sd = np.sqrt(np.diag(refit.gains)).reshape(3, 3)
    assert np.abs((linear.state.gain - refit.state.gain) / sd).max() < 0.2
    assert np.degrees(carry_error(linear, np.flatnonzero(out))).max() < 0.5


def test_one_bad_turn_moves_little() -> None:
    made, log = known(6)
    turn = log.turns[5]
    rate = turn.rate.copy()
    rate[len(rate) // 2 :] += 0.05
    bad = Turn(turn.rest, turn.t, rate, turn.force, turn.moving)
    spoilt = TurnLog(**{**vars(log), "turns": (*log.turns[:5], bad, *log.turns[6:])})
    fit = fit_turns(spoilt)
    assert fit.weight[5] == fit.weight.min() < 0.2
    assert np.abs(far(fit, made)).max() < 5.0


@pytest.mark.parametrize("seed", [6, 7, 8])
def test_one_bad_rest_moves_little(seed: int) -> None:
    """Whichever way it is off, also across gravity, where its size is what it should be: it is
    told apart, or the two turns that meet it are."""
    made, log = known(seed)
    good = fit_turns(log)
    force, push = log.force.copy(), np.random.default_rng(seed).normal(size=3)
    up = force[7] / np.linalg.norm(force[7])
    for off in (push, push - up * (up @ push)):
        force[7] = log.force[7] + 0.04 * off / np.linalg.norm(off)
        fit = fit_turns(replace(log, force=force))
        assert min(fit.rest_weight[7], fit.weight[6:8].max()) < 0.01
        sd = np.sqrt(np.diag(fit.covariance))[:18]
        assert np.all(sd < 2.5 * np.sqrt(np.diag(good.covariance))[:18])
        assert np.abs(far(fit, made)).max() < 4.5
