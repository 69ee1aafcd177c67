"""By how much the gyroscope of an IMU is later than its accelerometer, from turns by hand.

From rest to rest both turn the same angle, so that gravity shows no delay. The moving accelerometer
does: the velocity is zero where rests end and begin. With f in g, R(t) from the body at t to that
at the start,

    r = ∫ R f dt - T u_k = 0,    dr = -∫ [S(t)]x R δω dt,    S(t) = ∫_t^T R f ds

(exchange of the integrals in the variation of R). f counts in the motion alone, where `Turn.moving`
is one, and T is how long that lasts; δω counts wherever the turn has samples, by trapezoids, with
half of a sample's own R f ahead of it. A delay τ is δω = τ dω/dt. It is estimated last,
all else held at the joint fit with its covariance, and informs nothing of it: what the
accelerometer meets in motion is no part of a model of rests.
"""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import cross_matrix
from imucalib.estimators.carried import attitudes, shares
from imucalib.estimators.turn_log import Turn, remove_bias
from imucalib.estimators.turns import (
    ACCELEROMETER,
    GAIN,
    LOWER,
    TurnFit,
    exposure,
    tangents,
)

#: g √s, densities of what the accelerometer reads beside the motion, that are weighed; and s below
#: which no such delay is known, for a filter passes for one.
_DENSITIES = 1e-5 * 2.0 ** np.arange(14)
_LEAST = 2e-4
_USUAL = 0.05  # s, sd of what filters, buses and drivers delay by


def lateness(fit: TurnFit) -> tuple[float, float]:
    """s by which the gyroscope is late (negative: early), and its standard deviation: mean and sd
    over the densities, each as likely before, of turns that took part, all of one weight."""
    used = [turn for turn, own in zip(fit.log.turns, fit.used, strict=True) if own]
    rows = [_of_turn(fit, turn) for turn in used]
    misfit, along, jacobian = (np.concatenate([row[k] for row in rows]) for k in range(3))
    shared = jacobian @ fit.covariance @ jacobian.T
    for k, (_, _, _, own, _) in enumerate(rows):
        shared[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += own
    span = np.repeat([row[4] for row in rows], 3)
    found = np.empty((len(_DENSITIES), 3))
    for k, density in enumerate(_DENSITIES):
        root = np.linalg.cholesky(shared + np.diag(density**2 * span))
        y, x = np.linalg.solve(root, np.column_stack([misfit, along])).T
        known = float(x @ x) + _USUAL**-2
        late = -float(x @ y) / known
        power = float(np.sum((y + late * x) ** 2)) + (late / _USUAL) ** 2
        volume = float(np.log(np.diag(root)).sum()) + 0.5 * np.log(known)
        found[k] = -0.5 * power - volume, late, 1.0 / known
    likely = np.exp(found[:, 0] - found[:, 0].max())
    likely /= likely.sum()
    mean = float(likely @ found[:, 1])
    square = float(likely @ (found[:, 2] + (found[:, 1] - mean) ** 2))
    return mean, float(np.sqrt(square + _LEAST**2))


def _of_turn(fit: TurnFit, turn: Turn) -> tuple[Array, Array, Array, Array, float]:
    """r (3,), its columns by the delay (3,) and by the fit's parameters (3, P), the covariance
    (3, 3) that the gyroscope's white noise gives it, and for how long (s) the accelerometer's noise
    adds up: the motion and, where its ends lie between samples, one more."""
    log, state, k = fit.log, fit.state, turn.rest
    seen, share = remove_bias(log, state.drift, turn)
    session = log.session[k]
    force, away = state.force(turn.force, session), turn.force - state.bias_at(session)
    rate, columns = exposure(state, seen, force, turn, fit.laws)
    true, h = rate @ state.gain.T, shares(turn.t)
    whole, fast = attitudes(turn.t, true), h * (turn.moving == 1.0)
    weighted = whole * fast[:, None, None]
    each = np.einsum("nij,nj->ni", weighted, force)
    ahead = np.cumsum(each[::-1], axis=0)[::-1] - 0.5 * each
    moved = -cross_matrix(ahead) @ (whole * h[:, None, None])
    gained = moved @ state.gain
    first, apart, ups = ACCELEROMETER + GAIN, state.first_offset, state.first_up
    jacobian, span = np.zeros((3, fit.covariance.shape[0])), float(fast.sum())
    jacobian[:, :3] = -weighted.sum(axis=0) @ state.lower
    if state.offset.size:
        jacobian[:, apart + 3 * session : apart + 3 * session + 3] = jacobian[:, :3]
    for column, (i, j) in enumerate(LOWER):
        jacobian[:, 3 + column] = away[:, j] @ weighted[:, :, i]
    jacobian[:, ACCELEROMETER:first] = np.tensordot(moved, rate, (0, 0)).reshape(3, GAIN)
    jacobian[:, first:apart] = -np.einsum("nij,njm->im", gained, columns)
    for rest, own in ((k, 1.0 - share), (k + 1, share)):
        at = state.first_drift + 3 * rest
        jacobian[:, at : at + 3] = -np.tensordot(own * turn.moving, gained, 1)
    jacobian[:, ups + 2 * k : ups + 2 * k + 2] = -span * tangents(state.up)[k]
    noisy = np.einsum("nij,nkj->ik", gained * (turn.moving**2 / h)[:, None, None], gained)
    slope = np.gradient(true, turn.t, axis=0)
    return (
        each.sum(axis=0) - span * state.up[k],
        np.einsum("nij,nj->i", moved, slope),
        jacobian,
        log.white**2 * noisy,
        span + float(h.mean()),
    )
